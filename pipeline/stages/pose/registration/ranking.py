"""Rank object poses by how well they explain a touch: contact, and space without contact.

The misfit adds areas: contact surface off the object, and object surface that would have made
contact but did not, because it penetrates the membrane or rests on it outside the contact. The
latter distinguishes positions along a flat face, and notches that a membrane bridges; an object is
placed by it along directions that its surface does not determine.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, Indices
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.distance_grid import DistanceGrid
from pipeline.stages.pose.registration.model import ObjectModel
from pipeline.stages.pose.registration.scene import ContactScene

_CLEARANCE_MM = 0.05  # an object this far before the membrane is within the depth's error
_OUTLINE_PX = 2.0  # uncertainty (px) of the contact's outline
CORRELATION_MM = 0.5  # correlation length of errors of the membrane's shape
LEAST_SPREAD_MM = 0.02  # smallest std of the membrane's shape
_MAX_DEVIATIONS = 3.0  # standard deviations of depth that may put the membrane behind a near object
_SIGNIFICANT = 2.0  # standard errors above which two misfits differ
_FIRST_STEP_MM = 0.8
_N_SIZES = 6  # each half of the one before, the last 0.025 mm
_MAX_ROUNDS = 40
# translation (mm) that must raise the misfit for the outline to determine the place
_TRIAL_MM = 0.5
# rise of the misfit that counts: share, and mm
_NOTICED_SHARE = 0.05
_NOTICED_MM = 0.01


@frozen
class PoseJudge:
    """A scene and an object, thinned for comparison."""

    scene: ContactScene
    points_mm: Doubles  # (k, 3) of the contact
    model: ObjectModel
    kernel_inputs: tuple[Any, ...]  # of `measure_unexplained`, after the poses

    def misfit_mm(self, poses: Sequence[Doubles] | Doubles) -> Doubles:
        """Return the root mean square misfit (n,) of each sensor_from_object over the contact's
        area.
        """
        means, _ = self._measure_unexplained(np.array(poses, dtype=np.float64).reshape(-1, 4, 4))
        return np.sqrt(means[:, 0] + means[:, 1] * self.area_ratio)

    @property
    def area_ratio(self) -> float:
        """Area of the object over that of the contact."""
        return self.model.area_mm2 / self.scene.area_mm2

    def make_buffers(self) -> tuple[Doubles, Doubles, Indices]:
        """Buffers of the kernels: squares of contact points and model points, and the latter's
        pixels.
        """
        n_model = len(self.model.points_mm)
        return np.empty(len(self.points_mm)), np.empty(n_model), np.empty(n_model, np.int32)

    def distinguishes(self, better: Doubles, other: Doubles) -> bool:
        """Return whether one pose fits better than the other by more than the touch's own error.

        A membrane that is off by e in one independent place (their area: 2 pi l^2) changes the
        difference of squared distances by 2 e (d - d'); e is what the better pose leaves
        unexplained.
        """
        spread_mm = max(float(self.misfit_mm([better])[0]), LEAST_SPREAD_MM)
        patch_mm2 = 2.0 * math.pi * CORRELATION_MM**2
        share = min(1.0, patch_mm2 / self.scene.area_mm2)
        (felt_a, unfelt_a), (felt_b, unfelt_b) = (
            self._by_place(pose, patch_mm2) for pose in (better, other)
        )
        gap = float((felt_b - felt_a).mean()) + share * float((unfelt_b - unfelt_a).sum())
        contact_sq = share * float(((np.sqrt(felt_b) - np.sqrt(felt_a)) ** 2).mean())
        unfelt_sq = share**2 * float(((np.sqrt(unfelt_b) - np.sqrt(unfelt_a)) ** 2).sum())
        return gap > _SIGNIFICANT * 2.0 * spread_mm * math.sqrt(contact_sq + unfelt_sq)

    def _by_place(self, pose: Doubles, patch_mm2: float) -> tuple[Doubles, Doubles]:
        """Return (k,) squares of contact points, and mean squares of the object's over image
        patches (tiles,).
        """
        of_felt, of_points, pixel = self._measure_unexplained(
            np.array(pose, dtype=np.float64)[None]
        )[1]
        side_px = max(1.0, math.sqrt(patch_mm2) / self.scene.pixel_mm)
        rows, cols = self.scene.camera.shape
        row, col = (np.floor(at / side_px).astype(np.intp) for at in np.divmod(pixel, cols))
        tiles_across = int(cols / side_px) + 1
        tiles_down = int(rows / side_px) + 1
        found = np.bincount(row * tiles_across + col, of_points, tiles_across * tiles_down)
        per_point = self.model.area_mm2 / max(len(self.model.points_mm), 1) / patch_mm2
        return of_felt, np.asarray(found * per_point, dtype=np.float64)

    def _measure_unexplained(
        self, poses: Doubles
    ) -> tuple[Doubles, tuple[Doubles, Doubles, Indices]]:
        """Return (n, 2) mean squares of poses (n, 4, 4), and those of each point for the last
        pose, with the pixels.
        """
        from pipeline.stages.pose.registration.registration_kernels import measure_unexplained

        means = np.empty((len(poses), 2))
        last = self.make_buffers()
        measure_unexplained(poses, *self.kernel_inputs, means, last)
        return means, last


def make_judge(
    scene: ContactScene,
    grid: DistanceGrid,
    model: ObjectModel,
    n_contact: int,
    n_model: int,
    limit_mm: float,
) -> PoseJudge:
    """Return a judge on about `n_contact` contact points and `n_model` model points."""
    step = max(1, len(scene.points_mm) // n_contact)
    points_mm, normals = (np.ascontiguousarray(a[::step]) for a in (scene.points_mm, scene.normals))
    thin = model.thin(n_model)
    camera = scene.camera
    pixel_mm = scene.pixel_mm
    # A light contact is within the depth's error: an object just before the membrane may have
    # touched it.
    within_mm = _MAX_DEVIATIONS * math.hypot(scene.noise_mm, scene.error.rms_mm)
    view = (
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        within_mm,
        max(_CLEARANCE_MM, pixel_mm / 2),
        _OUTLINE_PX * pixel_mm,
        scene.membrane_mm,
        scene.off_contact_mm,
    )
    inputs = (points_mm, normals, grid.lattice, (thin.points_mm, thin.normals), view, limit_mm)
    return PoseJudge(scene=scene, points_mm=points_mm, model=thin, kernel_inputs=inputs)


def align_to_outline(
    pose: Doubles, weak_motions: Doubles, about_mm: Doubles, by: PoseJudge
) -> Doubles:
    """Return `pose` moved along the weak motions (k, 6) to the least misfit, by pattern search
    with step halving.
    """
    from pipeline.stages.pose.registration.registration_kernels import search_pattern

    steps = np.concatenate([weak_motions, -weak_motions])
    sizes_mm = _FIRST_STEP_MM * 0.5 ** np.arange(_N_SIZES)
    motions = rigid.apply_screw(np.eye(4), np.multiply.outer(sizes_mm, steps), about_mm)
    best = np.array(pose)
    search_pattern(best, motions, _MAX_ROUNDS, by.area_ratio, by.kernel_inputs, by.make_buffers())
    return best


def outline_constrains(pose: Doubles, motion: Doubles, about_mm: Doubles, by: PoseJudge) -> bool:
    """Return whether the outline determines the place along one motion (6,): moving either way
    fits worse.
    """
    trials = np.outer((0.0, _TRIAL_MM, -_TRIAL_MM), motion)
    here, one, other = by.misfit_mm(rigid.apply_screw(pose, trials, about_mm))
    return bool(min(one, other) > here * (1 + _NOTICED_SHARE) + _NOTICED_MM)
