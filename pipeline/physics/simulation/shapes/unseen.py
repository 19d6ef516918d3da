"""Six shapes that training never sees: each differs from the twelve in geometry, not only in
size.
"""

import math

import numpy as np

from pipeline.core.geometry.symmetry import asymmetric, cyclic, revolution
from pipeline.physics.simulation.shapes.polygons import make_arc, make_strip, thin_curve
from pipeline.physics.simulation.shapes.solids import (
    Shape,
    count_circle_sides,
    make_chamfered_prism,
    make_rounded_prism,
    revolve_profile,
    sweep_section,
)
from pipeline.physics.simulation.shapes.training import make_fork_outline

_BACK_MM = 8.0
_DENSE = 4001  # points that a curve is thinned from


def ellipse() -> Shape:
    """An elliptic ring of 13 x 8 mm."""
    angle = np.linspace(0.0, 2.0 * math.pi, _DENSE)
    path = thin_curve(np.column_stack([5.7 * np.cos(angle), 3.2 * np.sin(angle)]), 0.8)[:-1]
    return Shape(
        mesh=sweep_section(path, make_strip(1.6, 0.4, 6.0), "ellipse", endless=True),
        symmetry=cyclic(2),
    )


def letters() -> Shape:
    """The strokes of an E and a T that share their upper bar, 14 x 9 mm."""
    outline = [
        (-7.0, -4.5), (-1.5, -4.5), (-1.5, -2.8),
        (-5.2, -2.8), (-5.2, -0.85), (-2.2, -0.85), (-2.2, 0.85),
        (-5.2, 0.85), (-5.2, 2.8), (2.1, 2.8), (2.1, -4.5),
        (3.9, -4.5), (3.9, 2.8), (7.0, 2.8), (7.0, 4.5),
        (-7.0, 4.5),
    ]  # fmt: skip
    return Shape(mesh=make_chamfered_prism(outline, 6.0, 0.35, "letters"), symmetry=asymmetric())


def cross() -> Shape:
    """Four lines at right angles, 9, 6, 7 and 4 mm long."""
    outline = make_fork_outline((0.0, 90.0, 180.0, 270.0), (9.0, 6.0, 7.0, 4.0), 2.6)
    return Shape(mesh=make_rounded_prism(outline, _BACK_MM, 0.9, "cross"), symmetry=asymmetric())


def cone() -> Shape:
    """A blunt cone of 60 degrees from its axis, its tip rounded by 0.5 mm."""
    tip = make_arc(0.5, -90.0, -60.0, (0.0, 0.5))
    rise = (6.0 - tip[-1, 0]) * math.tan(math.radians(30.0))
    profile = np.concatenate([tip, [(6.0, tip[-1, 1] + rise), (6.0, 12.0)]])
    return Shape(
        mesh=revolve_profile(profile, count_circle_sides(6.0), "cone"), symmetry=revolution()
    )


def wave() -> Shape:
    """A ridge along one and a half waves of 10 mm length and 1.5 mm height."""
    x = np.linspace(-7.5, 7.5, _DENSE)
    crests = thin_curve(np.column_stack([x, 1.5 * np.sin(x * (2.0 * math.pi / 10.0))]), 0.7)
    leg = np.array([0.5, 0.0])  # level as the crests are, so that the ends are cut square
    path = np.concatenate([crests[:1] - leg, crests, crests[-1:] + leg])
    return Shape(mesh=sweep_section(path, make_strip(1.4, 0.5, 6.0), "wave"), symmetry=cyclic(2))


def star() -> Shape:
    """A flat star of five points, 13 mm across."""
    angle = np.arange(10) * math.pi / 5.0
    radius = np.where(np.arange(10) % 2 == 0, 6.5, 3.2)
    outline = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return Shape(mesh=make_chamfered_prism(outline, _BACK_MM, 0.3, "star"), symmetry=cyclic(5))


ALL = (ellipse, letters, cross, cone, wave, star)
