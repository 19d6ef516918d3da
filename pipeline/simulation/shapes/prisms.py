"""Prisms over a plane outline, their tactile face at z = 0 and its edge broken all around."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry.meshes import Mesh
from pipeline.simulation.shapes.polygons import Outline, arc, counter_clockwise, ears, inset
from pipeline.simulation.shapes.solids import Face, closed, walls


def bar(outline_mm: Outline | Doubles, height_mm: float, chamfer_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face chamfered by 45 degrees.

    Raises MeshProblem when the outline crosses itself or the chamfer is wider than the polygon.
    """
    outer = counter_clockwise(outline_mm, name)
    return stacked([level(inset(outer, chamfer_mm), 0.0), level(outer, chamfer_mm), level(outer, height_mm)], name)


def rounded(outline_mm: Outline | Doubles, height_mm: float, radius_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face rounded off by a quarter of a circle.

    Raises MeshProblem when the outline crosses itself or the rounding is wider than the polygon.
    """
    outer = counter_clockwise(outline_mm, name)
    return stacked([*rounding(outer, radius_mm), level(outer, height_mm)], name)


def stacked(rings_mm: Sequence[Doubles], name: str) -> Mesh:
    """A body over level outlines (n, 3) from the tactile face up, all counter-clockwise and with as many points."""
    n, top = len(rings_mm[0]), (len(rings_mm) - 1) * len(rings_mm[0])
    faces: list[Face] = [(c, b, a) for a, b, c in ears(rings_mm[0][:, :2])]  # the tactile face looks to -z
    faces += [(a + top, b + top, c + top) for a, b, c in ears(rings_mm[-1][:, :2])]
    return closed(np.concatenate(rings_mm), [*faces, *walls(len(rings_mm), n)], name)


def level(outline_mm: Doubles, z_mm: float) -> Doubles:
    """An outline (n, 2) at a height; (n, 3)."""
    return np.column_stack([outline_mm, np.full(len(outline_mm), z_mm)])


def rounding(outline_mm: Doubles, radius_mm: float) -> list[Doubles]:
    """The level outlines (n, 3) of a tactile face rounded off by a quarter of a circle; it ends upright."""
    quarter = arc(radius_mm, -90.0, 0.0, (0.0, radius_mm))
    return [level(inset(outline_mm, radius_mm - float(x)), float(z)) for x, z in quarter]
