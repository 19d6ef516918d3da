"""Whether a generated touch is deeper than what the source felt lets anything be, for methods that know pictures alone.

What was felt lies no nearer to the source's camera than its membrane can be pushed in; from there, by the alignment, no
nearer to the target's. A network that was taught on sensors which stand otherwise to each other makes its touches as
deep as those were.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.stage_warnings import StageWarning
from pipeline.geometry import rigid
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import GeneratedTouch

_STRIDE = 8  # pixels of the source: its view is all that is asked
_SLACK_MM = 1.0
_SHARE = 0.05  # of the view that has to be deeper


def check_depth_limit(
    touch: GeneratedTouch, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> tuple[StageWarning, ...]:
    """A doubt where a bubble's touch lies nearer to its camera than anything felt can; none of a gel's picture."""
    if not target.sensor_kind.is_depth:
        return ()
    nearest = np.array(source.rest_depth_mm, np.float64) - source.limits.indentation_max_mm
    points = source.camera.back_project(nearest)[::_STRIDE, ::_STRIDE].reshape(-1, 3)
    x_mm, y_mm, z_mm = rigid.apply(alignment.target_from_source, points).T
    camera = target.camera
    ahead = z_mm > 0
    col, row = np.zeros(z_mm.shape, np.int64), np.zeros(z_mm.shape, np.int64)
    col[ahead] = np.rint(camera.fx_px * x_mm[ahead] / z_mm[ahead] + camera.cx_px)
    row[ahead] = np.rint(camera.fy_px * y_mm[ahead] / z_mm[ahead] + camera.cy_px)
    seen = ahead & (row >= 0) & (row < camera.rows) & (col >= 0) & (col < camera.cols)
    if not seen.any():
        return ()
    beyond_mm = z_mm[seen] - touch.image[row[seen], col[seen]]
    if (beyond_mm > _SLACK_MM).mean() <= _SHARE:
        return ()
    return (
        StageWarning(
            f"{float(beyond_mm.max()):.1f} mm deeper than anything can be that the source felt: what made this touch "
            "was taught on sensors that stand otherwise to each other; physics and T2D2 reckon with how they stand"
        ),
    )
