"""A gel's picture read with fewer pixels: a draft in a quarter of the time, on as many pixels as the full answer."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np

from pipeline.base.arrays import Floats, Image, freeze
from pipeline.calibration.calibration_table import Calibration
from pipeline.geometry.camera import Camera
from pipeline.sensors.spec import SensorSpec
from pipeline.values.frames import TactileFrame
from pipeline.values.pixel_index import make_pixel_index
from pipeline.values.results import DepthMap

MAX_SIDE_PX = 220  # along the longer side of a draft; with half as many a faint touch is no longer seen
DRAFT_ITERATIONS = 2  # of the correction by the sensor's optics
_HALF = 0.5


def compute_downsampling(shape: tuple[int, int]) -> int:
    """How many pixels of the full picture lie along a side of one of the draft."""
    return max(1, math.ceil(max(shape) / MAX_SIDE_PX))


def downsample_frame(whole: TactileFrame, camera: Camera, by: int) -> TactileFrame:
    """A gel's frame, which `camera` took, with `by` times fewer pixels along each side."""
    seen = camera.resize(*_size(camera, by))
    image, reference = (_averaged(cast("Image", picture), seen) for picture in (whole.image, whole.reference))
    return replace(whole, image=image, reference=reference, camera=seen, context_frames=())


def downsample_calibration(calibration: Calibration | None, by: int) -> Calibration | None:
    """The same look-up for such a picture."""
    if calibration is None:
        return None
    rows, cols = (max(1, n // by) for n in (calibration.rows, calibration.cols))
    return replace(calibration, rows=rows, cols=cols, pixel_mm=calibration.pixel_mm * calibration.cols / cols)


def upsample_depth(found: DepthMap, source: SensorSpec, by: int) -> DepthMap:
    """The answer of such a frame on the pixels of `source`, and the note that it is a draft."""
    shape = source.camera.shape
    indentation = _grown(found.indentation_mm, shape)
    note = f"a draft at 1/{by} of the resolution, as long as a slider is held"
    return replace(
        found,
        indentation_mm=freeze(indentation),
        depth_mm=freeze((source.rest_depth_mm - indentation).astype(np.float32)),
        contact=freeze(_grown(found.contact.astype(np.float32), shape) > _HALF),
        camera=source.camera,
        source_index=make_pixel_index(shape),
        notes=(note, *found.notes),
        expected_error_mm=None if found.expected_error_mm is None else freeze(_grown(found.expected_error_mm, shape)),
    )


def _size(camera: Camera, by: int) -> tuple[int, int]:
    return max(1, camera.rows // by), max(1, camera.cols // by)


def _averaged(picture: Image, seen: Camera) -> Image:
    import cv2

    return freeze(np.asarray(cv2.resize(picture, (seen.cols, seen.rows), interpolation=cv2.INTER_AREA), np.uint8))


def _grown(values: Floats, shape: tuple[int, int]) -> Any:
    import cv2

    return np.asarray(cv2.resize(values, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
