"""Small edits of an alignment, one axis at a time, about a point that stays where it is.

A turn about the camera's origin would carry a touch that is tens of millimetres away from it out of the picture, so
that every turn would have to be made good by a shift. About the middle of the contact a turn is only a turn.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.geometry import rigid
from pipeline.sensors.alignment import Alignment, correct_alignment
from pipeline.sensors.offsets import Axis, compose_motion
from pipeline.values.results import DepthMap


def axis_unit(axis: Axis) -> str:
    """`mm` of a shift, `deg` of a turn."""
    return "deg" if axis.startswith("r") else "mm"


def compute_pivot_mm(depth: DepthMap, alignment: Alignment) -> Doubles:
    """The contact's centroid (3,) in the target frame; of the whole surface in view where nothing touches.

    It is found once, when an edit begins: a pivot that follows the edit would let the touch drift.
    """
    known = np.isfinite(depth.depth_mm)
    where = known & depth.contact
    if not where.any():
        where = known
    if not where.any():
        return freeze(rigid.apply(alignment.target_from_source, np.zeros(3)))
    row, col = np.nonzero(where)
    ray_x, ray_y = depth.camera.rays()
    z = depth.depth_mm[where].astype(np.float64)
    centre = np.array([(ray_x[col] * z).mean(), (ray_y[row] * z).mean(), z.mean()])
    return freeze(rigid.apply(alignment.target_from_source, centre))


def nudge(alignment: Alignment, axis: Axis, amount: float, *, pivot_mm: Doubles) -> Alignment:
    """The alignment with the touch shifted by `amount` mm along an axis, or turned by `amount` deg about it.

    The axis is one of the target frame; turns are about `pivot_mm` (3,), which stays where it is.
    """
    direction = amount * np.eye(3)["xyz".index(axis[-1])]
    if axis_unit(axis) == "deg":
        return correct_alignment(alignment, compose_motion(pivot_mm, np.deg2rad(direction), np.zeros(3)))
    return correct_alignment(alignment, compose_motion(pivot_mm, np.zeros(3), direction))
