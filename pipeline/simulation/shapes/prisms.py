"""Prisms over a plane outline, the tactile face at z = 0 with a chamfered or rounded edge."""

from collections.abc import Sequence

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry.meshes import Mesh
from pipeline.simulation.shapes.polygons import (
    Outline,
    inset_polygon,
    make_arc,
    orient_counter_clockwise,
    triangulate_polygon,
)
from pipeline.simulation.shapes.solids import Face, make_mesh, make_wall_faces


def make_chamfered_prism(outline_mm: Outline | Doubles, height_mm: float, chamfer_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face chamfered by 45 degrees.

    Raises MeshProblem when the outline crosses itself or the chamfer is wider than the polygon.
    """
    outer = orient_counter_clockwise(outline_mm, name)
    return stack_rings(
        [
            lift_outline(inset_polygon(outer, chamfer_mm), 0.0),
            lift_outline(outer, chamfer_mm),
            lift_outline(outer, height_mm),
        ],
        name,
    )


def make_rounded_prism(outline_mm: Outline | Doubles, height_mm: float, radius_mm: float, name: str) -> Mesh:
    """A prism over a simple polygon, its tactile face rounded by a quarter circle.

    Raises MeshProblem when the outline crosses itself or the rounding is wider than the polygon.
    """
    outer = orient_counter_clockwise(outline_mm, name)
    return stack_rings([*make_rounded_rings(outer, radius_mm), lift_outline(outer, height_mm)], name)


def stack_rings(rings_mm: Sequence[Doubles], name: str) -> Mesh:
    """A body over level outlines (n, 3) from the tactile face up, counter-clockwise, with equal numbers of points."""
    n, top = len(rings_mm[0]), (len(rings_mm) - 1) * len(rings_mm[0])
    faces: list[Face] = [
        (c, b, a) for a, b, c in triangulate_polygon(rings_mm[0][:, :2])
    ]  # the tactile face looks to -z
    faces += [(a + top, b + top, c + top) for a, b, c in triangulate_polygon(rings_mm[-1][:, :2])]
    return make_mesh(np.concatenate(rings_mm), [*faces, *make_wall_faces(len(rings_mm), n)], name)


def lift_outline(outline_mm: Doubles, z_mm: float) -> Doubles:
    """An outline (n, 2) at a height; (n, 3)."""
    return np.column_stack([outline_mm, np.full(len(outline_mm), z_mm)])


def make_rounded_rings(outline_mm: Doubles, radius_mm: float) -> list[Doubles]:
    """Level outlines (n, 3) of a tactile face rounded by a quarter circle; the last is vertical."""
    quarter = make_arc(radius_mm, -90.0, 0.0, (0.0, radius_mm))
    return [lift_outline(inset_polygon(outline_mm, radius_mm - float(x)), float(z)) for x, z in quarter]
