"""How quick and how right is the membrane test? Ours against Open3D's signed distance to the
membrane's mesh.

    python -m benchmarks.membrane

38,000 points lie around the soft bubble's dome, and around a level pad. An error is a point whose
side is not that of the exact height field (the mesh's own bilinear surface), counted where it lies
more than a micrometre off the surface. Open3D's mesh splits each cell into two triangles, which is
up to 0.2 um off the bilinear surface here.
"""

from __future__ import annotations

import numpy as np

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from benchmarks.scenes.rest_mesh import rest_mesh
from pipeline.core.geometry import membrane
from pipeline.core.geometry.membrane import Membrane

_N = 38_000
_BAND_MM = 1e-3
_SPREAD_MM = 1.0


def open3d_distance(surface: Membrane, points_mm: np.ndarray, samples: int):
    import open3d as o3d

    mesh = rest_mesh(surface)
    world = o3d.t.geometry.RaycastingScene()
    world.add_triangles(
        o3d.core.Tensor(mesh.vertices_mm.astype(np.float32)),
        o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
    )
    query = o3d.core.Tensor(points_mm)
    return lambda: world.compute_signed_distance(query, nsamples=samples).numpy()


def around(surface: Membrane, half_x_mm: float, half_y_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """(points (n, 3) float32, how far each lies behind the surface along z)."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-half_x_mm, half_x_mm, _N)
    y = rng.uniform(-half_y_mm, half_y_mm, _N)
    points = np.stack(
        [x, y, surface.depth_at(x, y) + rng.normal(0.0, _SPREAD_MM, _N)], axis=-1
    ).astype(np.float32)
    exact = points.astype(np.float64)
    return points, exact[:, 2] - surface.depth_at(exact[:, 0], exact[:, 1])


def measure() -> BenchmarkResult:
    rows: list[Measurement] = []
    points: list[PlotPoint] = []
    notes: list[str] = []
    # 0.34 mm: the dome of 60x50 mm on 175 columns, as a target's own depth image would give it.
    surfaces = {
        "dome": membrane.make_dome_membrane(60.0, 20.0, 30.0, 25.0, 0.34),
        "level pad": membrane.make_flat_membrane(20.0, 12.0, 9.0),
    }
    for name, surface in surfaces.items():
        size = {"dome": (28.0, 23.0), "level pad": (11.0, 8.0)}[name]
        cloud, behind = around(surface, *size)
        calls = {
            "ours": lambda s=surface, p=cloud: s.signed_distance_mm(p),
            "Open3D, 1 ray": open3d_distance(surface, cloud, 1),
            "Open3D, 5 rays": open3d_distance(surface, cloud, 5),
        }
        wrong = {k: wrong_sides(call(), behind) for k, call in calls.items()}
        times = time_in_turns(calls, runs=7, calls=5)
        rows.append(
            build_measurement(
                f"side of a {name}: {_N:,} points",
                peer="Open3D compute_signed_distance",
                ours=times["ours"],
                ours_error=wrong["ours"],
                peer_timing=times["Open3D, 1 ray"],
                peer_error=wrong["Open3D, 1 ray"],
                unit="wrong",
                bar=Requirement(min_speedup=80.0, max_error=0.0),
            )
        )
        points += [
            PlotPoint(
                method=f"{k}, {name}", ms=times[k].median_ms, error=wrong[k], ours=k == "ours"
            )
            for k in calls
        ]
        notes.append(f"{name}: lattice of {surface.z_mm.shape[0]}x{surface.z_mm.shape[1]} nodes")
    return BenchmarkResult(
        title="membrane sign test",
        unit="wrong",
        rows=tuple(rows),
        points=tuple(points),
        notes=tuple(notes),
    )


def wrong_sides(distance_mm: np.ndarray, behind_mm: np.ndarray) -> int:
    """Points on the wrong side; either sense of Open3D's open sheet is taken as right for all
    points at once.
    """
    asked = np.abs(behind_mm) > _BAND_MM
    off = int(((distance_mm > 0) != (behind_mm > 0))[asked].sum())
    return min(off, int(asked.sum()) - off)


if __name__ == "__main__":
    print_result(measure())
