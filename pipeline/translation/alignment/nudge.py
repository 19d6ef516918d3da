"""Small edits of an alignment, one axis at a time, about a fixed pivot.

A rotation about the camera's origin would move a touch tens of millimetres away out of the image.
About the contact's centroid it is a pure rotation.
"""

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.geometry import rigid
from pipeline.core.values.results import Cloud, DepthMap
from pipeline.sensors.alignment import Alignment, Axis, compose_motion, correct_alignment
from pipeline.sensors.spec import SensorSpec


def axis_unit(axis: Axis) -> str:
    """Return `mm` for a translation axis, `deg` for a rotation axis."""
    return "deg" if axis.startswith("r") else "mm"


def compute_pivot_mm(depth: DepthMap, alignment: Alignment) -> Doubles:
    """Return the contact's centroid (3,) in the target frame.

    Of the whole visible surface where there is no contact.

    Compute it once, when an edit begins: a pivot that follows the edit lets the touch drift.
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
    """Return the alignment after translating the touch by `amount` mm along an axis, or rotating it
    by `amount` deg.

    The axis is one of the target frame; rotations keep `pivot_mm` (3,) in place.
    """
    direction = amount * np.eye(3)["xyz".index(axis[-1])]
    if axis_unit(axis) == "deg":
        return correct_alignment(
            alignment, compose_motion(pivot_mm, np.deg2rad(direction), np.zeros(3))
        )
    return correct_alignment(alignment, compose_motion(pivot_mm, np.zeros(3), direction))


_ITERATIONS = 3  # on a curved membrane the distance changes along the optical axis


def compute_centring_offset_mm(cloud: Cloud, indentation_mm: float, target: SensorSpec) -> Doubles:
    """Translation (3,) in the target frame: the touch's centre to the middle of the membrane, as
    deep as in the source.

    `indentation_mm` is how far the source was pushed in; the target is pushed in as far, at most by
    its own limit. A cloud without points needs no offset.
    """
    points = cloud.points_mm.astype(np.float64)
    if not len(points):
        return np.zeros(3)
    rows, cols = target.camera.shape
    middle = target.camera.back_project(target.rest_depth_mm)[rows // 2, cols // 2]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    offset = middle - centre
    depth_mm = min(indentation_mm, target.limits.indentation_max_mm)
    for _ in range(_ITERATIONS):
        offset[2] -= depth_mm + float(target.membrane.signed_distance_mm(points + offset).min())
    return offset
