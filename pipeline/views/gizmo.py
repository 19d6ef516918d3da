"""Geometry of a gizmo: which part is where on the screen, and what dragging it does.

Arrows translate, rings rotate, the centre translates in the plane of the view, and the ball within
the rings rotates freely.
"""

import math
from collections.abc import Callable

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import AXES

Project = Callable[[Doubles], Doubles]  # points (n, 3) in mm from the pivot -> pixels (n, 2)
CENTRE = "centre"
BALL = "ball"
ARROW_PX = 46.0
RING_PX = 66.0
MIDDLE_PX = 8.0
_NEAR_PX = 7.0
_SHORTEST_PX = 12.0  # an arrow that points to the eye is left out
_FLATTEST = 0.2  # and a ring that is seen from its edge
_FINE = 0.1  # of a motion that is to be fine
_CIRCLE = np.stack([f(np.linspace(0.0, 2.0 * np.pi, 49)) for f in (np.cos, np.sin)], axis=-1)


class GizmoGeometry:
    """A gizmo under one projection; `is_solid` where it is seen in 3D, with the free rotation."""

    def __init__(self, project: Project, *, is_solid: bool) -> None:
        self._project = project
        self._is_solid = is_solid
        steps = project(0.5 * np.concatenate([np.eye(3), -np.eye(3)]))
        self.px_of_mm: Doubles = (steps[:3] - steps[3:]).T  # (2, 3) at the pivot
        self.centre_px: Doubles = project(np.zeros((1, 3)))[0]
        lengths = np.linalg.norm(self.px_of_mm, axis=0)
        self._mm_of_px = 1.0 / max(float(lengths.max()), 1e-9)  # along the axis that is seen best
        sides = self.px_of_mm * self._mm_of_px
        areas = [abs(float(np.linalg.det(sides[:, _list_others(k)]))) for k in range(3)]
        arrows = [k for k in range(3) if ARROW_PX * self._mm_of_px * lengths[k] > _SHORTEST_PX]
        self._is_seen = np.isin(np.arange(3), arrows)
        # by the name of the axis, in pixels (n, 2)
        self.arrows_px = {AXES[k]: self._find_arrow(k) for k in arrows}
        self.rings_px = {AXES[3 + k]: self._find_ring(k) for k in range(3) if areas[k] > _FLATTEST}

    def find_part(self, at_px: Doubles) -> str:
        """Return the part at a position (2,); "" for none."""
        off = at_px - self.centre_px
        if np.abs(off).max() <= MIDDLE_PX:
            return CENTRE
        lines = {**self.arrows_px, **self.rings_px}
        distances = {part: _measure_distance(line, at_px) for part, line in lines.items()}
        part = min(distances, key=distances.__getitem__, default="")
        if part and distances[part] < _NEAR_PX:
            return part
        return BALL if self._is_solid and math.hypot(*off) < RING_PX else ""

    def find_motion(
        self, part: str, begin_px: Doubles, end_px: Doubles, *, fine: bool
    ) -> tuple[Doubles, Doubles]:
        """Return the translation (3,) in mm and the rotation vector (3,) in rad of a drag."""
        scale = _FINE if fine else 1.0
        off = scale * (end_px - begin_px)
        shift, turn = np.zeros(3), np.zeros(3)
        if part == CENTRE:
            shift = np.linalg.pinv(self.px_of_mm * self._is_seen) @ off
        elif part == BALL:
            right, down = (row / max(float(np.linalg.norm(row)), 1e-12) for row in self.px_of_mm)
            # what is nearest to the eye goes with the mouse
            turn = np.cross(np.cross(down, right), off[0] * right + off[1] * down) / RING_PX
        elif part in AXES[:3]:
            along = self.px_of_mm[:, AXES.index(part)]
            shift[AXES.index(part)] = along @ off / max(float(along @ along), 1e-12)
        else:
            axis = AXES.index(part) - 3
            inverse = np.linalg.inv(self.px_of_mm[:, _list_others(axis)])
            a, b = (inverse @ (at - self.centre_px) for at in (begin_px, end_px))
            turn[axis] = scale * math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))
        return shift, turn

    def _find_arrow(self, axis: int) -> Doubles:
        return self._project(np.stack([np.zeros(3), ARROW_PX * self._mm_of_px * np.eye(3)[axis]]))

    def _find_ring(self, axis: int) -> Doubles:
        circle = np.zeros((len(_CIRCLE), 3))
        circle[:, _list_others(axis)] = RING_PX * self._mm_of_px * _CIRCLE
        return self._project(circle)


def describe_motion(shift_mm: Doubles, rotation: Doubles) -> str:
    """Return a translation (3,) and a rotation (3, 3) in words; what does not move is left out."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    values = (*shift_mm, *np.rad2deg(rigid.rotation_vector_rad(pose)))
    return "  ".join(
        f"{axis} {value:+.2f} {'mm' if len(axis) == 1 else '°'}"
        for axis, value in zip(AXES, values, strict=True)
        if abs(value) > 5e-3
    )


def _list_others(axis: int) -> list[int]:
    return [(axis + 1) % 3, (axis + 2) % 3]


def _measure_distance(line_px: Doubles, place: Doubles) -> float:
    """Return the distance of a position (2,) from a line through points (n, 2)."""
    begin, way = line_px[:-1], np.diff(line_px, axis=0)
    share = np.einsum("ij,ij->i", place - begin, way) / np.maximum((way**2).sum(axis=1), 1e-12)
    nearest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(np.linalg.norm(place - nearest, axis=1).min())
