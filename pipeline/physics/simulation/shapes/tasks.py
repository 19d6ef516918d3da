"""The objects of the downstream tasks: three tools, a pencil, a cup's rim and a marble.

And the sample's elbow.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.core.geometry.symmetry import X, asymmetric, cyclic, revolution
from pipeline.physics.simulation.shapes.polygons import make_arc, make_bow, make_strip
from pipeline.physics.simulation.shapes.solids import (
    Shape,
    lift_outline,
    loft,
    make_chamfered_prism,
    sweep_section,
    transform_mesh,
)
from pipeline.physics.simulation.shapes.training import make_ball_on_shaft


def hex_key() -> Shape:
    """A bent hexagonal key of 4 mm over its flats, lying on a flat: arms of 10 and 20 mm.

    The origin is on its axis.
    """
    corner_mm = 4.0 / math.sqrt(3.0)
    angle = np.arange(6) * math.pi / 3.0
    section = corner_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    bend = make_arc(5.0, -180.0, -90.0, (5.0, 5.0), beyond_mm=corner_mm)
    path = np.concatenate([[(0.0, 20.0)], bend, [(10.0, 0.0)]])
    mesh = transform_mesh(
        sweep_section(path, section, "hex_key"), rigid.translation(-2.0, -4.0, 0.0)
    )
    return Shape(mesh=mesh, symmetry=asymmetric())


def screwdriver() -> Shape:
    """The end of a flat screwdriver: a blade of 6 x 1 mm that widens to a round shaft."""
    angle = 2.0 * math.pi * np.arange(64) / 64.0
    round_ = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [
        lift_outline(_make_rectangle(round_, 2.9, 0.4), 0.0),
        lift_outline(_make_rectangle(round_, 3.0, 0.5), 0.1),
        lift_outline(_make_rectangle(round_, 3.2, 1.4), 6.0),
        lift_outline(3.0 * round_, 11.0),
        lift_outline(3.0 * round_, 20.0),
    ]
    return Shape(mesh=loft(np.stack(rings), "screwdriver"), symmetry=cyclic(2))


def spanner() -> Shape:
    """The open mouth of a spanner for 8 mm, turned by 15 degrees from its handle, lying flat."""
    # half widths, floor of the mouth, radius of the head
    mouth = 4.0
    depth = -2.0
    head = 9.0
    handle = 3.0
    lip = math.degrees(math.asin(mouth / head))
    neck = math.degrees(math.asin(handle / head))
    near = make_arc(head, lip + 10.0, 195.0 - neck)
    tail = (
        np.array([(24.0, -handle), (24.0, handle)])
        @ rigid.rotation((0.0, 0.0, math.radians(195.0)))[:2, :2].T
    )
    far = make_arc(head, 195.0 + neck, 350.0 - lip)
    floor = [
        (7.6, -mouth),
        (depth + 2.0, -mouth),
        (depth, -2.0),
        (depth, 2.0),
        (depth + 2.0, mouth),
        (7.6, mouth),
    ]
    return Shape(
        mesh=make_chamfered_prism(np.concatenate([near, tail, far, floor]), 5.0, 0.4, "spanner"),
        symmetry=asymmetric(),
    )


def pencil() -> Shape:
    """A hexagonal pencil of 7 mm over its flats, lying on a flat, with its sharpened end.

    The origin is on its axis.
    """
    tip_x = 13.0
    end_x = -11.0
    half_flat = 3.5
    half_angle = math.radians(15.0)
    angle = np.linspace(0.0, 2.0 * math.pi, 121)[:-1]
    within = (angle + math.pi / 6.0) % (math.pi / 3.0) - math.pi / 6.0
    radius = half_flat / np.cos(within)  # flats at 0, 60, ... degrees
    # where the cone leaves the hexagon: nearer the tip on the flats
    wood = tip_x - radius / math.tan(half_angle)
    lead = 0.3  # radius of the worn tip
    rings = [
        _make_ring(angle, radius, np.full(120, end_x)),
        _make_ring(angle, radius, wood),
        _make_ring(angle, np.full(120, lead), np.full(120, tip_x - lead / math.tan(half_angle))),
    ]
    upright = loft(np.stack(rings), "pencil")
    # The axis to x; a flat, not an edge, is lowest.
    return Shape(
        mesh=transform_mesh(upright, rigid.rotation((0.0, math.pi / 2.0, 0.0))),
        symmetry=cyclic(6, X),
    )


def cup_rim() -> Shape:
    """A piece of 26 mm of a cup's rim: 40 mm radius, 2.4 mm thick, rounded."""
    path = make_bow(40.0, math.degrees(25.0 / 40.0), 0.5, 1.2)
    return Shape(
        mesh=sweep_section(path, make_strip(2.4, 1.2, 9.0), "cup_rim"), symmetry=asymmetric()
    )


def marble() -> Shape:
    """A marble of 16 mm diameter on a shaft."""
    return Shape(mesh=make_ball_on_shaft(8.0, "marble"), symmetry=revolution())


def notched_elbow() -> Shape:
    """An angle piece: arms of 24 and 13 mm, 3.5 mm wide, a notch near the bend.

    No turn or flip maps it to itself.
    """
    outline = [
        (-1.75, -1.75), (11.0, -1.75), (11.0, 1.75),
        (6.2, 1.75), (6.2, 0.2), (4.2, 0.2), (4.2, 1.75),
        (1.75, 1.75), (1.75, 22.0), (-1.75, 22.0),
    ]  # fmt: skip
    return Shape(
        mesh=make_chamfered_prism(outline, height_mm=8.0, chamfer_mm=0.5, name="notched_elbow"),
        symmetry=asymmetric(),
    )


def _make_rectangle(round_: Doubles, half_x_mm: float, half_y_mm: float) -> Doubles:
    """The outline of a rectangle with one point for each of a circle, corners included."""
    scale = np.maximum(np.abs(round_[:, 0]), np.abs(round_[:, 1]))[:, None]
    return round_ / scale * (half_x_mm, half_y_mm)


def _make_ring(angle: Doubles, radius_mm: Doubles, z_mm: Doubles) -> Doubles:
    return np.column_stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle), z_mm])


ALL = (hex_key, screwdriver, spanner, pencil, cup_rim, marble)
