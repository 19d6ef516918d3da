"""Prisms over a plane outline, their tactile face at z = 0 and its edge broken all around."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import Doubles
from pipeline.meshes import Mesh
from pipeline.physics.shapes.polygons import Outline, arc, counter_clockwise, ears, inset
from pipeline.physics.shapes.solids import Face, closed, walls


def bar(outline_mm: Outline | Doubles, height_mm: float, chamfer_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face chamfered by 45 degrees.

    Raises MeshProblem when the outline crosses itself or the chamfer is wider than the polygon.
    """
    return _stacked(outline_mm, np.array([(chamfer_mm, 0.0), (0.0, chamfer_mm), (0.0, height_mm)]), name)


def rounded(outline_mm: Outline | Doubles, height_mm: float, radius_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face rounded off by a quarter of a circle.

    Raises MeshProblem when the outline crosses itself or the rounding is wider than the polygon.
    """
    quarter = arc(radius_mm, -90.0, 0.0, (0.0, radius_mm))
    quarter[:, 0] = radius_mm - quarter[:, 0]
    return _stacked(outline_mm, np.concatenate([quarter, [(0.0, height_mm)]]), name)


def _stacked(outline_mm: Outline | Doubles, levels_mm: Doubles, name: str) -> Mesh:
    """The outline inset by `levels_mm` [:, 0] at the heights [:, 1], from the tactile face up."""
    outer = counter_clockwise(outline_mm, name)
    rings = [np.column_stack([inset(outer, width), np.full(len(outer), z)]) for width, z in levels_mm]
    n, top = len(outer), (len(rings) - 1) * len(outer)
    faces: list[Face] = [(c, b, a) for a, b, c in ears(rings[0][:, :2])]  # the tactile face looks to -z
    faces += [(a + top, b + top, c + top) for a, b, c in ears(outer)]
    return closed(np.concatenate(rings), [*faces, *walls(len(rings), n)], name)
