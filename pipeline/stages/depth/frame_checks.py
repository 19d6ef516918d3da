"""What every method of the stage checks of a frame before it is measured."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import MissingReference, SensorMismatch, ShapeError
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.gel.settings import REST


def see_by_frame(source: SensorSpec, frame: TactileFrame) -> SensorSpec:
    """The sensor with the frame's own camera, where it has one."""
    return source if frame.camera is None else source.with_camera(frame.camera)


def check_frame(frame: TactileFrame, source: SensorSpec) -> None:
    """Raise ShapeError for a frame that no method can read."""
    where = f"frame {frame.index} of {source.title}"
    image = frame.image
    reference = frame.reference
    if reference is None:
        raise MissingReference(
            f"no reference image for {where}; record one frame without contact, or choose its "
            "image as the reference (reference=, --reference)"
        )
    camera = frame.camera or source.camera
    kind = source.sensor_kind
    wanted = camera.shape if kind.is_depth else (*camera.shape, 3)
    for what, array in (("image", image), ("reference", reference)):
        if array.shape != wanted:
            raise SensorMismatch(
                f"the {what} of {where} must have shape {wanted}, got {array.shape}; choose the "
                "right sensor"
            )
        problem = kind.find_image_problem(array)
        if problem:
            raise ShapeError(f"the {what} of {where} {problem}")
    lost = 0.0 if kind.is_depth else _measure_lost_share(image, reference)
    if lost > REST.lost_share:
        raise ShapeError(
            f"{lost:.0%} of the image of {where} is black where its reference is not: a part of "
            "it was lost, or the "
            "light failed; leave this frame out"
        )


def _measure_lost_share(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """Share of the pixels (rows, cols, 3) that are black in the image alone: no touch casts such
    a shadow.
    """
    lost = (image[..., 1] <= REST.black_grey) & (reference[..., 1] > REST.lit_grey)
    return (
        float((lost & (image <= REST.black_grey).all(axis=2)).mean())
        if lost.mean() > REST.lost_share
        else 0.0
    )


def make_untouched_depth(
    frame: TactileFrame, source: SensorSpec, notes: tuple[str, ...]
) -> DepthMap:
    """The result without contact.

    Its arrays are the same for each camera of a gel, and each reference of a bubble.
    """
    rest = (
        frame.reference if frame.is_depth and frame.reference is not None else source.rest_depth_mm
    )
    return _make_untouched(rest, source.camera, notes)


@derive_once
def _make_untouched(rest_mm: NDArray[Any], camera: Camera, notes: tuple[str, ...]) -> DepthMap:
    return DepthMap(
        indentation_mm=freeze(np.zeros(camera.shape, np.float32)),
        depth_mm=freeze(np.where(rest_mm > 0, rest_mm, np.nan).astype(np.float32)),
        contact=freeze(np.zeros(camera.shape, np.bool_)),
        camera=camera,
        source_index=make_pixel_index(camera.shape),
        notes=notes,
    )
