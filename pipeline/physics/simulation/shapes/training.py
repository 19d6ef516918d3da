"""The twelve indenters that networks are trained on: flat, curved and angled, sized for a gel of 18
x 13 mm.

Like the lab's tools, they are ridges proud of bodies with rounded shoulders: a gel touches the
ridge, a bubble the body too. Ball and peg end a shaft.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.symmetry import X, Z, asymmetric, cyclic, revolution
from pipeline.physics.simulation.shapes.polygons import (
    FINE_MM,
    SHOULDER_MM,
    STAMP_MM,
    make_apex,
    make_arc,
    make_bow,
    make_crest,
    make_shoulder,
    make_stamp,
    place_on_shoulders,
)
from pipeline.physics.simulation.shapes.solids import (
    Shape,
    count_circle_sides,
    lift_outline,
    make_rounded_rings,
    revolve_profile,
    stack_rings,
    sweep_section,
    transform_mesh,
)

_BACK_MM = 18.0  # height of bodies: more than a bubble's approach, 13 mm in data sets, and a press
# width of lines, and the radius of their edges
_LINE_MM = 3.0
_LINE_EDGE_MM = 1.2
_ARM_MM = 30.0  # length of lines from where they meet: the lab's
_STRAIGHT_RAD = 1e-6


def square() -> Shape:
    """A flat punch, 8 mm wide, on a square body."""
    profile = np.concatenate([[(3.7, 0.0), (4.0, 0.3)], make_stamp(4.0, _BACK_MM)])
    cornered = revolve_profile(profile * (math.sqrt(2.0), 1.0), 4, "square")
    return Shape(
        mesh=transform_mesh(cornered, rigid.rotation((0.0, 0.0, 0.25 * math.pi))),
        symmetry=cyclic(4),
    )


def edge() -> Shape:
    """The edge of a roof of 90 degrees, 60 mm long: as the lab's tools, longer than any gel."""
    section = make_apex(45.0, 0.3, SHOULDER_MM, _BACK_MM)
    return Shape(
        mesh=sweep_section(np.array([(-_ARM_MM, 0.0), (_ARM_MM, 0.0)]), section, "edge"),
        symmetry=cyclic(2),
    )


def corner() -> Shape:
    """The corner of a cube, on its tip."""
    profile = np.array([(0.0, 0.0), (STAMP_MM, STAMP_MM / math.sqrt(2.0)), (STAMP_MM, _BACK_MM)])
    return Shape(mesh=revolve_profile(profile, 3, "corner"), symmetry=cyclic(3))


def lines_45() -> Shape:
    """Two lines that meet at 45 degrees."""
    return Shape(mesh=_lines((-22.5, 22.5), "lines_45"), symmetry=asymmetric())


def lines_120() -> Shape:
    """Two lines that meet at 120 degrees."""
    return Shape(mesh=_lines((-60.0, 60.0), "lines_120"), symmetry=asymmetric())


def three_lines() -> Shape:
    """Three lines, a third of a turn apart."""
    return Shape(mesh=_lines((-120.0, 0.0, 120.0), "three_lines"), symmetry=cyclic(3))


def cylinder() -> Shape:
    """A rod of 5 mm radius and 60 mm length, lying along x; the origin is on its axis."""
    upright = revolve_profile(
        np.array([(5.0, -_ARM_MM), (5.0, _ARM_MM)]), count_circle_sides(5.0), "cylinder"
    )
    return Shape(
        mesh=transform_mesh(upright, rigid.rotation((0.0, math.pi / 2.0, 0.0))),
        symmetry=revolution(X, flip=Z),
    )


def sphere() -> Shape:
    """A ball of 5 mm radius that ends a shaft."""
    return Shape(mesh=make_ball_on_shaft(5.0, "sphere"), symmetry=revolution())


def ring() -> Shape:
    """A ring of 9 mm diameter, its ridge 2 mm wide, on a round body."""
    return Shape(
        mesh=revolve_profile(
            _make_frame_profile(make_crest(2.0, 0.5), 4.5), count_circle_sides(5.5), "ring"
        ),
        symmetry=revolution(),
    )


def hexagon() -> Shape:
    """The frame of a hexagon, 11 mm over the middle of its corners, on a hexagonal body."""
    flat = math.cos(math.pi / 6.0)  # of the distance of a side over that of a corner
    mesh = revolve_profile(
        _make_frame_profile(make_crest(1.8, 0.4), 5.5 * flat) * (1.0 / flat, 1.0), 6, "hexagon"
    )
    return Shape(mesh=mesh, symmetry=cyclic(6))


def peg() -> Shape:
    """The flat end of a round peg of 7 mm diameter."""
    return Shape(
        mesh=revolve_profile(
            np.array([(3.2, 0.0), (3.5, 0.3), (3.5, 20.0)]), count_circle_sides(3.5), "peg"
        ),
        symmetry=revolution(),
    )


def curve() -> Shape:
    """A ridge bent by 110 degrees of 10 mm radius, the lab's, with legs of 20 mm.

    Its middle is in its origin.
    """
    section = place_on_shoulders(make_crest(2.6, 1.1), _BACK_MM)
    return Shape(
        mesh=sweep_section(make_bow(10.0, 110.0, 20.0, FINE_MM), section, "curve"),
        symmetry=asymmetric(),
    )


def _lines(directions_deg: tuple[float, ...], name: str) -> Mesh:
    """Straight lines from the origin on a body with shoulders, cut square at their ends as the
    lab's are.
    """
    lengths = (_ARM_MM,) * len(directions_deg)
    rings = make_rounded_rings(make_fork_outline(directions_deg, lengths, _LINE_MM), _LINE_EDGE_MM)
    body = make_shoulder(0.5 * _LINE_MM, _LINE_EDGE_MM, _BACK_MM)[1:]
    rings += [
        lift_outline(make_fork_outline(directions_deg, lengths, 2.0 * float(half)), float(z))
        for half, z in body
    ]
    return stack_rings(rings, name)


def _make_frame_profile(ridge_mm: Doubles, middle_mm: float) -> Doubles:
    """The profile (n, 2) of a frame with this ridge at `middle_mm` from the axis, on a body with
    a floor inside.
    """
    half = float(ridge_mm[-1, 0])
    floor = [(0.0, FINE_MM), (middle_mm - half, FINE_MM)]
    return np.concatenate(
        [floor, ridge_mm + np.array([middle_mm, 0.0]), make_stamp(middle_mm + half, _BACK_MM)]
    )


def make_fork_outline(
    directions_deg: tuple[float, ...], lengths_mm: tuple[float, ...], width_mm: float
) -> Doubles:
    """The outline (n, 2) of straight lines from the origin, directions ascending,
    counter-clockwise.

    Neighbours meet mitred; where they leave more than half a turn between them, two facets round
    the outer corner.
    """
    half = 0.5 * width_mm
    points = list[Doubles]()
    n = len(directions_deg)
    for k, (direction, length) in enumerate(zip(directions_deg, lengths_mm, strict=True)):
        turn = math.radians(direction)
        along = np.array([math.cos(turn), math.sin(turn)])
        left = np.array([-math.sin(turn), math.cos(turn)])
        points += [length * along - half * left, length * along + half * left]
        gap = math.radians((directions_deg[(k + 1) % n] - direction) % 360.0)
        # the outlines of two neighbours meet on the line halfway between them
        middle = turn + 0.5 * gap
        outward = np.array([math.cos(middle), math.sin(middle)])
        if gap > math.pi + _STRAIGHT_RAD:
            right = turn + gap - 0.5 * math.pi
            points += [
                half * left,
                half * outward,
                half * np.array([math.cos(right), math.sin(right)]),
            ]
        else:
            points.append(half / math.sin(0.5 * gap) * outward)
    return np.array(points)


def make_ball_on_shaft(radius_mm: float, name: str) -> Mesh:
    """A ball on a shaft of 0.7 of its radius along z, fine to 2 mm above its lowest point, which
    is at z = 0.
    """
    fine_rad = math.acos(1.0 - FINE_MM / radius_mm)
    fine_deg = math.degrees(fine_rad) - 90.0
    cap = make_arc(radius_mm, -90.0, fine_deg, (0.0, radius_mm))
    rest = make_arc(radius_mm, fine_deg, 90.0 - math.degrees(math.asin(0.7)), (0.0, radius_mm))[
        8::8
    ]
    shaft = 0.7 * radius_mm
    profile = np.concatenate(
        [[(0.0, 0.0)], cap[1:], rest, [(shaft, 2.0 * radius_mm), (shaft, 2.5 * radius_mm)]]
    )
    # Chords around the axis are shortest near it, so that fewer do for the cap than for the whole
    # ball.
    return revolve_profile(
        profile, 4 * math.ceil(0.25 * math.sin(fine_rad) * count_circle_sides(radius_mm)), name
    )


ALL = (
    square,
    edge,
    corner,
    lines_45,
    lines_120,
    three_lines,
    cylinder,
    sphere,
    ring,
    hexagon,
    peg,
    curve,
)
