"""Sections of ridges, counter-clockwise in (offset, z), their tactile side at z = 0."""

from __future__ import annotations

import math

import numpy as np

from pipeline.arrays import Doubles
from pipeline.physics.shapes.polygons import arc


def strip(width_mm: float, edge_mm: float, height_mm: float) -> Doubles:
    """Flat with rounded edges of radius `edge_mm`, at most half the width; (n, 2)."""
    half, flat = 0.5 * width_mm, 0.5 * width_mm - edge_mm
    left = arc(edge_mm, -180.0, -90.0, (-flat, edge_mm))
    right = arc(edge_mm, -90.0, 0.0, (flat, edge_mm))
    if flat <= 0:
        right = right[1:]
    return np.concatenate([left, right, [(half, height_mm), (-half, height_mm)]])


def apex(flank_deg: float, radius_mm: float, half_width_mm: float, height_mm: float) -> Doubles:
    """A roof with flanks that rise by `flank_deg`, its edge rounded by `radius_mm`; (n, 2)."""
    top = arc(radius_mm, -90.0 - flank_deg, -90.0 + flank_deg, (0.0, radius_mm))
    eave = top[-1, 1] + (half_width_mm - top[-1, 0]) * math.tan(math.radians(flank_deg))
    walls = [(half_width_mm, eave), (half_width_mm, height_mm), (-half_width_mm, height_mm), (-half_width_mm, eave)]
    return np.concatenate([top, walls])
