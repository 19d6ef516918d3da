"""An offset that brings a touch into the target's view, where the described alignment misses it."""

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import Cloud

_ITERATIONS = 3  # on a curved membrane the distance changes along the optical axis


def compute_centring_offset_mm(cloud: Cloud, indentation_mm: float, target: SensorSpec) -> Doubles:
    """Translation (3,) in the target frame: the touch's centre to the middle of the membrane, as deep as in the source.

    `indentation_mm` is how far the source was pushed in; the target is pushed in as far, at most by its own limit.
    A cloud without points needs no offset.
    """
    points = cloud.points_mm.astype(np.float64)
    if not len(points):
        return np.zeros(3)
    rows, cols = target.camera.shape
    middle = target.camera.back_project(target.rest_depth_mm)[rows // 2, cols // 2]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    offset, depth_mm = middle - centre, min(indentation_mm, target.limits.indentation_max_mm)
    for _ in range(_ITERATIONS):
        offset[2] -= depth_mm + float(target.membrane.signed_distance_mm(points + offset).min())
    return offset
