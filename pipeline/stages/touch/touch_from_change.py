"""Touches of methods that generate images only: made of the change of a frame, and checked
against the source.
"""

from __future__ import annotations

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.core.errors import StageWarning
from pipeline.core.geometry import rigid
from pipeline.core.values.results import GeneratedTouch
from pipeline.physics.sensor_images import render_reference
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec


def make_touch_from_change(
    target: SensorSpec, change: Floats, notes: tuple[str, ...] = ()
) -> GeneratedTouch:
    """Touch of a change (rows, cols, channels): a gel's in shares of full brightness, a bubble's
    imprint in mm.

    The change is added to the reference image of the described sensor; source pixels are unknown.
    """
    shape = target.camera.shape
    kind = target.sensor_kind
    scaled = np.float32(kind.full_change) * (change[..., 0] if kind.is_depth else change)
    image = kind.apply_change(render_reference(target), scaled)
    return GeneratedTouch(
        image=freeze(image),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)),
        notes=notes,
    )


_STRIDE = 8  # px of the source; only its view is needed
_SLACK_MM = 1.0
_MIN_SHARE = 0.05  # share of the view that has to be deeper


def check_depth_limit(
    touch: GeneratedTouch, source: SensorSpec, target: SensorSpec, alignment: Alignment
) -> tuple[StageWarning, ...]:
    """A warning where a bubble's touch is deeper than the source can be pressed.

    Never for a gel's image.

    The contact lies no nearer to the source's camera than its membrane can be indented; the
    alignment gives the same limit for the target. A network trained on another alignment generates
    depths of that alignment.
    """
    if not target.sensor_kind.is_depth:
        return ()
    nearest = np.array(source.rest_depth_mm, np.float64) - source.limits.indentation_max_mm
    points = source.camera.back_project(nearest)[::_STRIDE, ::_STRIDE].reshape(-1, 3)
    x_mm, y_mm, z_mm = rigid.apply(alignment.target_from_source, points).T
    camera = target.camera
    ahead = z_mm > 0
    col = np.zeros(z_mm.shape, np.int64)
    row = np.zeros(z_mm.shape, np.int64)
    col[ahead] = np.rint(camera.fx_px * x_mm[ahead] / z_mm[ahead] + camera.cx_px)
    row[ahead] = np.rint(camera.fy_px * y_mm[ahead] / z_mm[ahead] + camera.cy_px)
    in_image = ahead & (row >= 0) & (row < camera.rows) & (col >= 0) & (col < camera.cols)
    if not in_image.any():
        return ()
    excess_mm = z_mm[in_image] - touch.image[row[in_image], col[in_image]]
    if (excess_mm > _SLACK_MM).mean() <= _MIN_SHARE:
        return ()
    return (
        StageWarning(
            f"the touch is {float(excess_mm.max()):.1f} mm deeper than the source can be pressed: "
            "the network was "
            "trained on another alignment of the sensors; use physics or T2D2"
        ),
    )
