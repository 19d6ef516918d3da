"""How well an object at a given place explains a touch: what was felt, and where nothing was.

The misfit adds up areas: felt surface that lies off the object, and object surface that would have been felt but was
not, because it sticks out through the membrane toward the camera or rests on it beside the contact. The latter is what
tells slides along a flat face apart, and notches that a membrane bridges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline import rigid
from pipeline.arrays import Doubles
from pipeline.camera import MIN_DEPTH_MM
from pipeline.registration.model import Model
from pipeline.registration.scene import Scene

_FREE_MM = 0.05  # an object this much before the membrane is still within the error of its depth
_FACING = -0.1  # largest cosine, object's normal to felt normal, below which a match is the far side of a thin wall


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """A scene and a model, thinned for comparison, with the model's search tree built once."""

    scene: Scene
    felt: Doubles  # (k, 3)
    felt_normals: Doubles  # (k, 3)
    model: Model
    tree: Any  # scipy's KDTree of the model's points, which is untyped
    limit_mm: float  # distances beyond it count as this much

    def misfit_mm(self, poses: Sequence[Doubles]) -> Doubles:
        """Root mean square misfit (n,) of each sensor_from_object over the contact's area."""
        sensor_from_object = np.asarray(poses)
        felt_sq = self._felt_sq(sensor_from_object)
        out_sq = self._sticking_out_sq(sensor_from_object) * (self.model.area_mm2 / self.scene.area_mm2)
        return np.sqrt(felt_sq + out_sq)

    def _felt_sq(self, poses: Doubles) -> Doubles:
        turns, shifts = poses[:, :3, :3], poses[:, :3, 3]
        in_object = (self.felt[None] - shifts[:, None]) @ turns  # R^T (p - t), rows
        _, index = self.tree.query(in_object, distance_upper_bound=self.limit_mm)
        near = index < len(self.model.points_mm)  # the tree's way of saying none
        normals = self.model.normals[np.where(near, index, 0)]
        facing = np.einsum("bki,bki->bk", normals, self.felt_normals[None] @ turns) > _FACING
        # Between the model's samples lies surface too: along it, only what exceeds their spacing is off the object.
        offset = in_object - self.model.points_mm[np.where(near, index, 0)]
        along_normal = np.einsum("bki,bki->bk", normals, offset)
        along_surface = np.sqrt(np.maximum((offset**2).sum(axis=-1) - along_normal**2, 0.0))
        beyond = np.maximum(along_surface - self.model.spacing_mm, 0.0)
        square = np.minimum(along_normal**2 + beyond**2, self.limit_mm**2)
        return np.where(near & facing, square, self.limit_mm**2).mean(axis=1)

    def _sticking_out_sq(self, poses: Doubles) -> Doubles:
        camera = self.scene.camera
        points = self.model.points_mm[None] @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        x_px, y_px, visible = camera.project(points)
        col = np.where(visible, np.rint(x_px), 0).astype(np.intp).clip(0, camera.cols - 1)
        row = np.where(visible, np.rint(y_px), 0).astype(np.intp).clip(0, camera.rows - 1)
        reach = self.scene.membrane_mm[row, col] - points[..., 2]
        before = reach - max(_FREE_MM, self.scene.pixel_mm / 2)
        # A face turned away is not felt, however near; where the membrane has no reading, nothing is known.
        toward = np.einsum("mi,bi->bm", self.model.normals, poses[:, 2, :3]) < 0
        counts = visible & toward & (points[..., 2] > MIN_DEPTH_MM)
        # Within two pixels the contact's own outline is not known better.
        beside = np.where(reach > 0.0, self.scene.off_contact_mm[row, col] - 2.0 * self.scene.pixel_mm, 0.0)
        wrong = np.minimum(np.maximum(np.maximum(before, beside), 0.0), self.limit_mm)
        return np.where(counts & (wrong > 0), wrong**2, 0.0).mean(axis=1)


def judge(scene: Scene, model: Model, n_felt: int, n_model: int, limit_mm: float) -> Judge:
    """A judge on about `n_felt` felt points and `n_model` model points."""
    from scipy.spatial import KDTree

    few = model.thinned(n_model)
    step = max(1, len(scene.points_mm) // n_felt)
    return Judge(
        scene=scene, felt=scene.points_mm[::step], felt_normals=scene.normals[::step],
        model=few, tree=KDTree(few.points_mm), limit_mm=limit_mm,
    )  # fmt: skip


def apart(a: Doubles, b: Doubles, at_mm: Doubles, mm: float, deg: float) -> bool:
    """Whether two poses differ by more than `mm` at a point of the sensor frame, or by more than `deg`."""
    relative = a @ rigid.invert(b)
    return bool(np.linalg.norm(rigid.apply(relative, at_mm) - at_mm) > mm or rigid.angle_deg(relative) > deg)
