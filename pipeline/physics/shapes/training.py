"""The twelve indenters that networks are trained on: flat, curved and angled, sized for a gel of 18 x 13 mm."""

from __future__ import annotations

import math

import numpy as np

from pipeline import rigid
from pipeline.arrays import Doubles
from pipeline.meshes import Mesh
from pipeline.physics.shapes.polygons import arc, bow
from pipeline.physics.shapes.prisms import bar, rounded
from pipeline.physics.shapes.sections import apex, strip
from pipeline.physics.shapes.shape import Shape
from pipeline.physics.shapes.solids import moved, sides, swept, turned
from pipeline.physics.shapes.symmetry import X, Z, asymmetric, cyclic, revolved

_BACK_MM = 16.0  # height of bars: more than a bubble's reach, 12 mm in data sets, and a press
_LINE_MM, _LINE_EDGE_MM = 3.0, 1.2  # width of lines, and the radius of their edges
_FINE_MM = 2.0  # no gel is pressed deeper


def square() -> Shape:
    """A flat punch, 8 mm wide."""
    mesh = bar([(-4, -4), (4, -4), (4, 4), (-4, 4)], _BACK_MM, 0.3, "square")
    return Shape(name="square", title="Square punch", group="training", mesh=mesh, symmetry=cyclic(4))


def edge() -> Shape:
    """The edge of a roof of 90 degrees, 40 mm long: as the lab's tools, longer than any gel."""
    mesh = swept(np.array([(-20.0, 0.0), (20.0, 0.0)]), apex(45.0, 0.3, 4.0, _BACK_MM), "edge")
    return Shape(name="edge", title="Edge", group="training", mesh=mesh, symmetry=cyclic(2))


def corner() -> Shape:
    """The corner of a cube, on its tip."""
    reach = 6.0  # of the three edges from the axis
    profile = np.array([(0.0, 0.0), (reach, reach / math.sqrt(2.0)), (reach, 10.0)])
    return Shape(
        name="corner", title="Cube corner", group="training", mesh=turned(profile, 3, "corner"), symmetry=cyclic(3)
    )


def lines_45() -> Shape:
    """Two lines of 24 mm that meet at 45 degrees."""
    mesh = rounded(fork((-22.5, 22.5), (24.0, 24.0), _LINE_MM), _BACK_MM, _LINE_EDGE_MM, "lines_45")
    return Shape(name="lines_45", title="Two lines at 45°", group="training", mesh=mesh, symmetry=asymmetric())


def lines_120() -> Shape:
    """Two lines of 22 mm that meet at 120 degrees."""
    mesh = rounded(fork((-60.0, 60.0), (22.0, 22.0), _LINE_MM), _BACK_MM, _LINE_EDGE_MM, "lines_120")
    return Shape(name="lines_120", title="Two lines at 120°", group="training", mesh=mesh, symmetry=asymmetric())


def three_lines() -> Shape:
    """Three lines of 18 mm, a third of a turn apart."""
    mesh = rounded(fork((-120.0, 0.0, 120.0), (18.0,) * 3, _LINE_MM), _BACK_MM, _LINE_EDGE_MM, "three_lines")
    return Shape(name="three_lines", title="Three lines", group="training", mesh=mesh, symmetry=cyclic(3))


def cylinder() -> Shape:
    """A rod of 5 mm radius and 40 mm length, lying along x; its frame is on its axis."""
    upright = turned(np.array([(5.0, -20.0), (5.0, 20.0)]), sides(5.0), "cylinder")
    mesh = moved(upright, rigid.rotation((0.0, math.pi / 2.0, 0.0)))
    return Shape(name="cylinder", title="Lying cylinder", group="training", mesh=mesh, symmetry=revolved(X, flip=Z))


def sphere() -> Shape:
    """A ball of 5 mm radius that ends a shaft."""
    return Shape(name="sphere", title="Sphere", group="training", mesh=ball(5.0, "sphere"), symmetry=revolved())


def ring() -> Shape:
    """A ring of 9 mm diameter, its ridge 2 mm wide."""
    circle = arc(4.5, 0.0, 360.0, beyond_mm=1.0)[:-1]
    mesh = swept(circle, strip(2.0, 0.5, 6.0), "ring", endless=True)
    return Shape(name="ring", title="Ring", group="training", mesh=mesh, symmetry=revolved())


def hexagon() -> Shape:
    """The frame of a hexagon, 11 mm over its corners."""
    corners = 5.5 * np.column_stack([f(np.arange(6) * math.pi / 3.0) for f in (np.cos, np.sin)])
    mesh = swept(corners, strip(1.8, 0.4, 6.0), "hexagon", endless=True)
    return Shape(name="hexagon", title="Hexagon frame", group="training", mesh=mesh, symmetry=cyclic(6))


def peg() -> Shape:
    """The flat end of a round peg of 7 mm diameter."""
    mesh = turned(np.array([(3.2, 0.0), (3.5, 0.3), (3.5, 20.0)]), sides(3.5), "peg")
    return Shape(name="peg", title="Peg", group="training", mesh=mesh, symmetry=revolved())


def curve() -> Shape:
    """A ridge bent by 110 degrees of 6 mm radius, with legs of 14 mm; its middle is in its frame's origin."""
    mesh = swept(bow(6.0, 110.0, 14.0, 1.3), strip(2.6, 1.1, _BACK_MM), "curve")
    return Shape(name="curve", title="Curved line", group="training", mesh=mesh, symmetry=asymmetric())


def fork(directions_deg: tuple[float, ...], lengths_mm: tuple[float, ...], width_mm: float) -> Doubles:
    """The outline (n, 2) of straight lines from the origin, directions ascending; neighbours meet mitred."""
    half, points = 0.5 * width_mm, list[Doubles]()
    n = len(directions_deg)
    for k, (direction, length) in enumerate(zip(directions_deg, lengths_mm, strict=True)):
        turn = math.radians(direction)
        along, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        points += [length * along - half * left, length * along + half * left]
        gap = math.radians((directions_deg[(k + 1) % n] - direction) % 360.0)
        middle = turn + 0.5 * gap  # the outlines of two neighbours meet on the line halfway between them
        points.append(half / math.sin(0.5 * gap) * np.array([math.cos(middle), math.sin(middle)]))
    return np.array(points)


def ball(radius_mm: float, name: str) -> Mesh:
    """A ball on a shaft of 0.7 of its radius along z, fine to 2 mm above its lowest point, which is at z = 0."""
    fine_rad = math.acos(1.0 - _FINE_MM / radius_mm)
    fine_deg = math.degrees(fine_rad) - 90.0
    cap = arc(radius_mm, -90.0, fine_deg, (0.0, radius_mm))
    rest = arc(radius_mm, fine_deg, 90.0 - math.degrees(math.asin(0.7)), (0.0, radius_mm))[8::8]
    shaft = 0.7 * radius_mm
    profile = np.concatenate([[(0.0, 0.0)], cap[1:], rest, [(shaft, 2.0 * radius_mm), (shaft, 2.5 * radius_mm)]])
    # Chords around the axis are shortest near it, so that fewer do for the cap than for the whole ball.
    return turned(profile, 4 * math.ceil(0.25 * math.sin(fine_rad) * sides(radius_mm)), name)


ALL = (square, edge, corner, lines_45, lines_120, three_lines, cylinder, sphere, ring, hexagon, peg, curve)
