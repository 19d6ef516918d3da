"""Sections of ridges and of the bodies that carry them, counter-clockwise in (offset, z), tactile side at z = 0.

The lab's pattern tools are beads of 1 mm radius that stand 1.07 mm proud of bodies with rounded shoulders of 7.5 mm
radius: arms of 30 mm length and 15 mm width, 37 mm from one finger to the other. Bubbles reach the
shoulders, gels do not.
"""

import math

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.simulation.shapes.polygons import compute_arc_step_rad, make_arc

SHOULDER_MM = 7.5  # radius of the lab's shoulders, and half the width of its tools' arms
STAMP_MM = 18.5  # half the width of bodies under compact patterns: the lab's tools are 37 mm wide between fingers
FINE_MM = 2.0  # gels are not pressed deeper: above it, chords may be coarse
_COARSE_RAD = math.radians(10.0)


def make_crest(width_mm: float, edge_mm: float) -> Doubles:
    """Flat with rounded edges of radius `edge_mm`, at most half the width, from the left foot to the right; (n, 2)."""
    flat = 0.5 * width_mm - edge_mm
    left = make_arc(edge_mm, -180.0, -90.0, (-flat, edge_mm))
    right = make_arc(edge_mm, -90.0, 0.0, (flat, edge_mm))
    return np.concatenate([left, right if flat > 0 else right[1:]])


def make_strip(width_mm: float, edge_mm: float, height_mm: float) -> Doubles:
    """A `make_crest` with vertical walls; (n, 2)."""
    half = 0.5 * width_mm
    return np.concatenate([make_crest(width_mm, edge_mm), [(half, height_mm), (-half, height_mm)]])


def make_apex(flank_deg: float, radius_mm: float, half_width_mm: float, height_mm: float) -> Doubles:
    """A roof with flanks that rise by `flank_deg`, its edge rounded by `radius_mm`; (n, 2)."""
    top = make_arc(radius_mm, -90.0 - flank_deg, -90.0 + flank_deg, (0.0, radius_mm))
    eave = top[-1, 1] + (half_width_mm - top[-1, 0]) * math.tan(math.radians(flank_deg))
    walls = [(half_width_mm, eave), (half_width_mm, height_mm), (-half_width_mm, height_mm), (-half_width_mm, eave)]
    return np.concatenate([top, walls])


def make_shoulder(half_mm: float, proud_mm: float, back_mm: float) -> Doubles:
    """The right side (n, 2) of a body under a ridge of this half width, from its foot at z = `proud_mm` to the back.

    The foot lies on a circle of `SHOULDER_MM` radius about the ridge's middle plane.
    """
    rise = math.sqrt(SHOULDER_MM**2 - half_mm**2)
    return _make_round(0.0, proud_mm + rise, math.asin(half_mm / SHOULDER_MM), back_mm)


def make_stamp(half_mm: float, back_mm: float) -> Doubles:
    """The right side (n, 2) of a body `2 STAMP_MM` wide under a compact pattern of this half width, from its foot.

    The foot is `FINE_MM` above the tactile side, out of reach of a gel even if tilted.
    """
    ledge = STAMP_MM - SHOULDER_MM
    return np.concatenate([[(half_mm, FINE_MM)], _make_round(ledge, FINE_MM + SHOULDER_MM, 0.0, back_mm)])


def place_on_shoulders(ridge_mm: Doubles, back_mm: float) -> Doubles:
    """The section (n, 2) of a ridge, given from its left foot to its right one, on a body with shoulders."""
    half, proud = ridge_mm[-1]
    right = make_shoulder(float(half), float(proud), back_mm)[1:]
    return np.concatenate([ridge_mm, right, (right * (-1.0, 1.0))[::-1]])


def _make_round(centre_mm: float, centre_z_mm: float, from_rad: float, back_mm: float) -> Doubles:
    """A quarter round of `SHOULDER_MM` from this angle off -z to the side, and the wall from there to the back."""
    lowest = centre_z_mm - FINE_MM
    until = math.acos(lowest / SHOULDER_MM) if lowest < SHOULDER_MM else 0.0
    fine = [from_rad]
    if until > from_rad:
        n = math.ceil((until - from_rad) / compute_arc_step_rad(SHOULDER_MM))
        fine = list(np.linspace(from_rad, until, n + 1))
    n = math.ceil((0.5 * math.pi - fine[-1]) / _COARSE_RAD)
    angle = np.array([*fine, *np.linspace(fine[-1], 0.5 * math.pi, n + 1)[1:]])
    round_ = np.column_stack([centre_mm + SHOULDER_MM * np.sin(angle), centre_z_mm - SHOULDER_MM * np.cos(angle)])
    return np.concatenate([round_, [(centre_mm + SHOULDER_MM, back_mm)]])
