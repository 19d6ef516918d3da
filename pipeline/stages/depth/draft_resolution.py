"""Drafts of a gel's depth: measured on a downsampled image in a quarter of the time, returned at full resolution."""

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np

from pipeline.base.arrays import Floats, Image, freeze
from pipeline.calibration.calibration_table import Calibration
from pipeline.geometry.camera import Camera
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap, make_pixel_index

MAX_SIDE_PX = 220  # longer side of a draft's image; at half of it faint touches are lost
_HALF = 0.5


def compute_downsampling(shape: tuple[int, int]) -> int:
    """Downsampling factor used for drafts (1 = full resolution)."""
    return max(1, math.ceil(max(shape) / MAX_SIDE_PX))


def downsample_frame(frame: TactileFrame, camera: Camera, by: int) -> TactileFrame:
    """A gel's frame, taken by `camera`, with `by` times fewer pixels along each side."""
    smaller = camera.resize(max(1, camera.rows // by), max(1, camera.cols // by))
    image, reference = (_average(cast("Image", image), smaller) for image in (frame.image, frame.reference))
    return replace(frame, image=image, reference=reference, camera=smaller, context_frames=())


def downsample_calibration(calibration: Calibration | None, by: int) -> Calibration | None:
    """The calibration for such a frame."""
    if calibration is None:
        return None
    rows, cols = (max(1, n // by) for n in (calibration.rows, calibration.cols))
    return replace(calibration, rows=rows, cols=cols, pixel_mm=calibration.pixel_mm * calibration.cols / cols)


def upsample_depth(draft: DepthMap, source: SensorSpec, by: int) -> DepthMap:
    """The result for such a frame at the resolution of `source`, with a note that it is a draft."""
    shape = source.camera.shape
    indentation = _resize(draft.indentation_mm, shape)
    note = f"a draft at 1/{by} of the resolution, as long as a slider is held"
    expected_error = draft.expected_error_mm
    return replace(
        draft,
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(_resize(draft.contact.astype(np.float32), shape) > _HALF),
        camera=source.camera,
        source_index=make_pixel_index(shape),
        notes=(note, *draft.notes),
        expected_error_mm=None if expected_error is None else freeze(_resize(expected_error, shape)),
    )


def _average(image: Image, camera: Camera) -> Image:
    import cv2

    return freeze(np.asarray(cv2.resize(image, (camera.cols, camera.rows), interpolation=cv2.INTER_AREA), np.uint8))


def _resize(values: Floats, shape: tuple[int, int]) -> Any:
    import cv2

    return np.asarray(cv2.resize(values, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
