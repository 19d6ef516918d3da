"""Does registration report motions that a contact does not determine? Ours against Open3D's ICP.

    python -m benchmarks.observability

Patches of rods, planes, spheres, pegs, edges, cones and of a tool that is fully determined, of
random size and pose, with 300 to 3000 points and 0 to 0.05 mm of noise. Normals are off by 0 to 2
degrees in each of two directions: in every second patch point by point, on facets 4 degrees wide as
a mesh of a round part has them, in the others cell by cell, as the gradients of a distance grid
are. The truth is geometry's: see `scenes/observability_patches.py` and `observability_score.py`,
also for the band that is left out.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, Timing, build_measurement, time_in_turns
from benchmarks.scenes import observability_score
from benchmarks.scenes.observability_patches import KINDS, Patch, draw_patch
from benchmarks.scenes.observability_score import ObservabilityScore
from pipeline.core.geometry import rigid
from pipeline.stages.pose.registration.observability import (
    Observability,
    Tolerances,
    assess_observability,
)

PATCHES = 250  # of each kind
DENSE = 8_000  # points that stand for the exact surface
CORRELATION_MM = 0.15  # of a gel's depth: neighbouring pixels are not independent
FACET_DEG = 4.0
CELL_MM = 0.25
SLIDE_MM = 1.5  # start of the rod
MAX_UNREPORTED_MM = 0.01
MISSED = 0.01  # share
PEER = "Open3D point-to-plane ICP"


def add_noise(patch: Patch, rng: np.random.Generator, noise_mm: float, facets: bool) -> Patch:
    """The patch as a sensor and a mesh have it: noisy points, normals of facets and off by up to
    2 degrees.
    """
    normals = patch.normals
    if facets and len(patch.free) and np.ptp(normals, axis=0).max() > 0:
        normals = facet_normals(normals)
    cells = np.arange(len(normals))
    if not facets:
        cells = np.unique(np.floor(patch.points_mm / CELL_MM), axis=0, return_inverse=True)[
            1
        ].ravel()
    off = math.radians(rng.uniform(0.0, 2.0)) * rng.standard_normal((cells.max() + 1, 3))
    normals = normals + off[cells]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    points = patch.points_mm + noise_mm * rng.standard_normal((len(normals), 1)) * patch.normals
    return Patch(points_mm=points, normals=normals, free=patch.free, area_mm2=patch.area_mm2)


def facet_normals(normals):
    """Normals that jump by `FACET_DEG`: those of the middle of each facet, in bands around z and
    in longitude.
    """
    step = math.radians(FACET_DEG)
    rise = np.arctan2(normals[:, 2], np.hypot(normals[:, 0], normals[:, 1]))
    around = np.arctan2(normals[:, 1], normals[:, 0])
    flat = np.abs(normals[:, 0]) < 1e-9  # a rod along x turns about it
    around = np.where(
        flat, np.sign(normals[:, 1]) * math.pi / 2, (np.floor(around / step) + 0.5) * step
    )
    rise = np.where(np.abs(normals[:, 2]) > 1 - 1e-12, rise, (np.floor(rise / step) + 0.5) * step)
    return np.stack(
        [np.cos(rise) * np.cos(around), np.cos(rise) * np.sin(around), np.sin(rise)], axis=1
    )


def score_patches(kind: str, seed: int) -> ObservabilityScore:
    """All patches of one kind."""
    total = ObservabilityScore()
    tolerances = Tolerances()
    for k in range(PATCHES):
        sizes = [seed, k]  # the dense patch is drawn from the same stream as the sparse one
        rng = np.random.default_rng([seed, k, 1])
        pose = rigid.rotation(rng.standard_normal(3) * 2.0)
        pose[:3, 3] = rng.uniform(-30.0, 30.0, 3)
        n = int(rng.integers(300, 3000))
        sigma_mm = rng.uniform(0.0, 0.05)
        sparse = add_noise(
            draw_patch(kind, np.random.default_rng(sizes), n), rng, sigma_mm, k % 2 == 1
        ).transform(pose)
        dense = draw_patch(kind, np.random.default_rng(sizes), DENSE).transform(pose)
        # of pixels that hang together
        n_eff = n / (1.0 + 2.0 * math.pi * CORRELATION_MM**2 * n / dense.area_mm2)
        observability = assess_observability(
            sparse.points_mm,
            sparse.normals,
            sparse.points_mm.mean(axis=0),
            max(sigma_mm, 1e-3) * math.sqrt(n / n_eff),
            tolerances=tolerances,
        )
        truth = observability_score.compute_true_motions(
            dense, n_eff, max(sigma_mm, 1e-3), tolerances
        )
        total += observability_score.score_named_motions(
            observability.weak_motions, sparse.points_mm.mean(axis=0), truth
        )
    return total


def measure_rod() -> tuple[Patch, np.ndarray, np.ndarray]:
    """(observed patch of a rod, points of the whole rod, their normals), the rod's frame being
    the sensor's.
    """
    rng = np.random.default_rng(0)
    angle = rng.uniform(-0.8, 0.8, 3000)
    along = rng.uniform(-4.0, 4.0, 3000)
    normals = np.stack([np.zeros(3000), np.sin(angle), np.cos(angle)], axis=1)
    points = (
        3.0 * normals
        + along[:, None] * np.eye(3)[0]
        + 0.03 * rng.standard_normal((3000, 1)) * normals
    )
    around = rng.uniform(0, 2 * math.pi, 20_000)
    far = rng.uniform(-20.0, 20.0, 20_000)
    model_normals = np.stack([np.zeros(20_000), np.sin(around), np.cos(around)], axis=1)
    press = Patch(
        points_mm=points, normals=normals, free=np.zeros((0, 6)), area_mm2=3.0 * 1.6 * 8.0
    )
    return press, 3.0 * model_normals + far[:, None] * np.eye(3)[0], model_normals


def registered_by_open3d(contact: Patch, model, normals):
    """Open3D's point-to-plane ICP from a start that is slid along the rod."""
    import open3d

    icp = open3d.pipelines.registration
    source, target = (
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(p))
        for p in (contact.points_mm, model)
    )
    target.normals = open3d.utility.Vector3dVector(normals)
    return icp.registration_icp(
        source,
        target,
        2.0,
        rigid.translation(SLIDE_MM, 0, 0),
        icp.TransformationEstimationPointToPlane(),
    )


def compute_unreported_mm(object_from_sensor, reported: Observability | None, at_mm) -> float:
    """How far the contact's middle is off in directions that the answer calls determined."""
    shift = np.concatenate(
        [
            rigid.rotation_vector_rad(object_from_sensor),
            rigid.apply(object_from_sensor, at_mm) - at_mm,
        ]
    )
    return float(np.linalg.norm((shift if reported is None else reported.observable @ shift)[3:]))


def measure() -> BenchmarkResult:
    tallies = {kind: score_patches(kind, seed) for seed, kind in enumerate(KINDS)}
    press, model, normals = measure_rod()
    middle = press.points_mm.mean(axis=0)

    def ours() -> Observability:
        return assess_observability(press.points_mm, press.normals, middle, 0.03)

    peer = registered_by_open3d(press, model, normals)
    ended = np.array(peer.transformation)
    aligned = ours()
    # of the answer alone: it does not register, so there is no race
    timing = time_in_turns({"ours": ours})["ours"]
    slid = build_measurement(
        f"rod slid by {SLIDE_MM} mm: error that the answer does not announce",
        ours=timing,
        ours_error=compute_unreported_mm(ended, aligned, middle),
        unit="mm",
        bar=Requirement(max_error=MAX_UNREPORTED_MM),
        peer=PEER,
        peer_error=compute_unreported_mm(ended, None, middle),
    )
    notes = [
        f"rod: Open3D ends {np.linalg.norm(ended[:3, 3]):.4f} mm off with fitness "
        f"{peer.fitness:.3f} and "
        f"rmse {peer.inlier_rmse:.3f} mm; ours says of the same answer: "
        f"{'; '.join(aligned.weak_directions)}",
        "precision of a method that names nothing is not defined; its recall is 0",
        *(_counts(kind, tally) for kind, tally in tallies.items()),
    ]
    rows = [line for kind, tally in tallies.items() for line in _rows(kind, tally, timing)]
    return BenchmarkResult(
        title="Unobservable motions named", unit="share", rows=(*rows, slid), notes=tuple(notes)
    )


def _rows(kind: str, tally: ObservabilityScore, timing: Timing) -> list[Measurement]:
    """Recall, where there is something to name, and precision."""
    asked = (("recall", tally.recall, 1.0), ("precision", tally.precision, math.nan))
    return [
        build_measurement(
            f"{kind}: unobservable directions, 1 - {what}",
            ours=timing,
            ours_error=1.0 - share,
            unit="share",
            bar=Requirement(max_error=MISSED),
            peer=PEER,
            peer_error=peer,
        )
        for what, share, peer in asked
        if what == "precision" or tally.n_weak
    ]


def _counts(kind: str, tally: ObservabilityScore) -> str:
    return (
        f"{kind}: {tally.n_weak} unobservable directions, {tally.n_named} named, {tally.n_false} "
        "named wrongly, "
        f"{tally.n_between} of {6 * PATCHES} too close to the limit to be scored"
    )


if __name__ == "__main__":
    print_result(measure())
