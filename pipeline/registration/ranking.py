"""How well an object at a given place explains a touch: what was felt, and where nothing was.

The misfit adds up areas: felt surface that lies off the object, and object surface that would have been felt but was
not, because it sticks out through the membrane toward the camera or rests on it beside the contact. The latter is what
tells slides along a flat face apart, and notches that a membrane bridges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Indices
from pipeline.geometry import rigid
from pipeline.geometry.distance_grid import DistanceGrid
from pipeline.registration.model import ObjectModel
from pipeline.registration.scene import ContactScene

_FREE_MM = 0.05  # an object this much before the membrane is still within the error of its depth
_OUTLINE_PX = 2.0  # within so many pixels the contact's own outline is not known better
CORRELATION_MM = 0.5  # errors of a membrane's shape hang together over this length
LEAST_SPREAD_MM = 0.02  # of what a membrane's shape is known to, however well something fits
_FAR = 3.0  # standard deviations of depth, by which errors put the membrane behind an object that only nears it
_TELLING = 2.0  # standard errors from which one misfit is larger than another


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseJudge:
    """A scene and an object, thinned for comparison."""

    scene: ContactScene
    points_mm: Doubles  # (k, 3)
    normals: Doubles  # (k, 3)
    grid: DistanceGrid
    model: ObjectModel
    limit_mm: float  # distances beyond it count as this much

    def misfit_mm(self, poses: Sequence[Doubles] | Doubles) -> Doubles:
        """Root mean square misfit (n,) of each sensor_from_object over the contact's area."""
        means, _ = self._unexplained(np.array(poses, dtype=np.float64).reshape(-1, 4, 4))
        return np.sqrt(means[:, 0] + means[:, 1] * (self.model.area_mm2 / self.scene.area_mm2))

    def distinguishes(self, better: Doubles, other: Doubles) -> bool:
        """Whether the touch fits one pose better than the other by more than the touch's own error can make up.

        A membrane that is off by e in one independent place (their area: 2 pi l^2) changes the difference of squared
        distances by 2 e (d - d'); e is what the better pose leaves unexplained.
        """
        spread_mm = max(float(self.misfit_mm([better])[0]), LEAST_SPREAD_MM)
        patch_mm2 = 2.0 * math.pi * CORRELATION_MM**2
        share = min(1.0, patch_mm2 / self.scene.area_mm2)
        (felt_a, unfelt_a), (felt_b, unfelt_b) = (self._by_place(pose, patch_mm2) for pose in (better, other))
        gap = float((felt_b - felt_a).mean()) + share * float((unfelt_b - unfelt_a).sum())
        felt_sq = share * float(((np.sqrt(felt_b) - np.sqrt(felt_a)) ** 2).mean())
        unfelt_sq = share**2 * float(((np.sqrt(unfelt_b) - np.sqrt(unfelt_a)) ** 2).sum())
        return gap > _TELLING * 2.0 * spread_mm * math.sqrt(felt_sq + unfelt_sq)

    def _by_place(self, pose: Doubles, patch_mm2: float) -> tuple[Doubles, Doubles]:
        """(k,) squares of the felt points, and mean squares of the object's over patches of the picture (tiles,)."""
        of_felt, of_points, pixel = self._unexplained(np.array(pose, dtype=np.float64)[None])[1]
        side_px = max(1.0, math.sqrt(patch_mm2) / self.scene.pixel_mm)
        rows, cols = self.scene.camera.shape
        row, col = (np.floor(at / side_px).astype(np.intp) for at in np.divmod(pixel, cols))
        tiles_across, tiles_down = int(cols / side_px) + 1, int(rows / side_px) + 1
        found = np.bincount(row * tiles_across + col, of_points, tiles_across * tiles_down)
        per_point = self.model.area_mm2 / max(len(self.model.points_mm), 1) / patch_mm2
        return of_felt, np.asarray(found * per_point, dtype=np.float64)

    def _unexplained(self, poses: Doubles) -> tuple[Doubles, tuple[Doubles, Doubles, Indices]]:
        """(n, 2) mean squares of poses (n, 4, 4), and those of each point for the last one, with the pixels."""
        from pipeline.registration.ranking_kernels import measure_unexplained

        camera, pixel_mm = self.scene.camera, self.scene.pixel_mm
        # A light touch is lost in the error of the depth: an object so little before the membrane was perhaps felt.
        within_mm = _FAR * math.hypot(self.scene.noise_mm, self.scene.error.rms_mm)
        view = (
            camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, within_mm,
            max(_FREE_MM, pixel_mm / 2), _OUTLINE_PX * pixel_mm, self.scene.membrane_mm, self.scene.off_contact_mm,
        )  # fmt: skip
        model, n_model = (self.model.points_mm, self.model.normals), len(self.model.points_mm)
        means, last = (
            np.empty((len(poses), 2)),
            (np.empty(len(self.points_mm)), np.empty(n_model), np.empty(n_model, np.int32)),
        )
        measure_unexplained(
            poses, self.points_mm, self.normals, self.grid.lattice, model, view, self.limit_mm, means, last
        )
        return means, last


def make_judge(
    scene: ContactScene, grid: DistanceGrid, model: ObjectModel, n_felt: int, n_model: int, limit_mm: float
) -> PoseJudge:
    """A judge on about `n_felt` felt points and `n_model` model points."""
    step = max(1, len(scene.points_mm) // n_felt)
    return PoseJudge(
        scene=scene, points_mm=np.ascontiguousarray(scene.points_mm[::step]),
        normals=np.ascontiguousarray(scene.normals[::step]), grid=grid, model=model.thin(n_model),
        limit_mm=limit_mm,
    )  # fmt: skip


def poses_differ(a: Doubles, b: Doubles, at_mm: Doubles, mm: float, deg: float) -> bool:
    """Whether two poses differ by more than `mm` at a point of the sensor frame, or by more than `deg`."""
    relative = a @ rigid.invert(b)
    return bool(np.linalg.norm(rigid.apply(relative, at_mm) - at_mm) > mm or rigid.rotation_angle_deg(relative) > deg)
