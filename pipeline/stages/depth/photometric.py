"""Stage one: how far the source sensor's surface is pushed in, and where it is touched.

A gel's picture goes through a colour-to-slope look-up and an exact integration (`gel_depth`); a bubble's depth image is
compared with its untouched one (`bubble_depth`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import MissingReference, SensorMismatch, SettingProblem, ShapeError, StageWarning
from pipeline.base.memo import Memo
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration import quality_notes
from pipeline.calibration.calibration_table import Calibration, make_built_in
from pipeline.engine.digests import compute_cached_digest
from pipeline.geometry.camera import Camera
from pipeline.physics.reference_colours import compare_colours
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import (
    bubble_depth,
    depth_error,
    draft_resolution,
    gel_depth,
)
from pipeline.stages.depth.illumination import frame_illumination
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.mirror_check import looks_mirrored
from pipeline.stages.depth.poisson import Boundary
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthErrorModel, DepthMap, make_pixel_index

_BLACK_GREY, _LIT_GREY = 2, 8  # grey levels: at most in a pixel that was lost, and more than that in its reference
_MAX_LOST_SHARE = 0.25  # of the pixels
_UNTOUCHED = "nothing touches the sensor"


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthParams:
    """Parameters of the photometric depth."""

    contact_limit: float = setting(
        1.0, "Contact limit", unit="x", low=0.2, high=10.0, step=0.1,
        help="smallest indentation that counts, in units of the sensor's own limit",
        source="our own; the limit is in the sensor's description",
    )  # fmt: skip
    pressure_share: float = setting(
        0.25, "Pressure share", unit="share", low=0.02, high=0.8, step=0.02,
        help="contact is where the pressure exceeds this share of its peak nearby",
        source="Johnson, Contact Mechanics, 1985", only="gel",
    )  # fmt: skip
    smoothing_px: float = setting(1.0, "Smoothing", unit="px", low=0.0, high=5.0, step=0.25,
                                  help="blur of the colour change, or of a bubble's depth",
                                  source="a Gaussian's standard deviation; how much is our own")  # fmt: skip
    boundary: Boundary = setting(
        "flat", "Integration border", choices=Boundary,
        help="flat: the gel is at rest around the touched part; free: nothing is known there",
        source="least-squares integral: Frankot and Chellappa 1988, Simchony et al. 1990", only="gel",
    )  # fmt: skip
    sensitivity: float = setting(
        1.0, "Sensitivity", unit="x", low=0.2, high=5.0, step=0.1,
        help="larger detects weaker touches: divides the sensor's limit of change without contact",
        source="our own; the limit is in the sensor's description",
    )  # fmt: skip
    draft: bool = False  # a gel's image is downsampled and refined less


AnyDepthParams = TypeVar("AnyDepthParams", bound=DepthParams)


def make_draft_params(params: AnyDepthParams) -> AnyDepthParams:
    """The parameters of a draft, for while a slider is dragged."""
    return replace(params, draft=True)


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation (mm, positive toward the camera), depth and contact of a frame, in the source sensor's frame.

    `calibration` None stands for the table that the sensor's description implies. The frame's own camera is used where
    it has one. Raises ShapeError for a frame that cannot be read, CalibrationError for one of another sensor.
    """
    progress.step(0.0, "comparing with the reference image")
    check_frame(frame, source)
    estimate = DEPTH_ESTIMATORS.get(source.sensor_kind)
    if estimate is None:
        raise SettingProblem(f"no physics estimates the depth of sensors of kind {source.kind!r} such as {source.name}")
    return estimate(frame, source, calibration, params, progress)


def estimate_bubble_frame(
    frame: TactileFrame, source: SensorSpec, _calibration: Calibration | None, params: DepthParams, _progress: Progress
) -> DepthMap:
    """`estimate_depth` of a bubble's frame that has been checked."""
    least_mm = params.contact_limit * source.limits.contact_min_mm
    found = bubble_depth.estimate_depth(
        frame, see_by_frame(source, frame), smoothing_px=params.smoothing_px, least_mm=least_mm
    )
    return replace(found, error=make_bubble_error(source))


def estimate_gel_frame(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, params: DepthParams, progress: Progress
) -> DepthMap:
    """`estimate_depth` of a gel's frame that has been checked; drafts have fewer pixels."""
    by = compute_downsampling(frame, source, params)
    if by == 1:
        return estimate_gel_depth(frame, source, calibration, params, progress)[0]
    illumination = estimate_illumination(frame, source, calibration, progress)
    seen_by = see_by_frame(source, frame)
    less = (
        draft_resolution.downsample_frame(frame, seen_by.camera, by),
        source,
        draft_resolution.downsample_calibration(calibration, by),
        scale_params(params, by),
    )
    return draft_resolution.upsample_depth(estimate_gel_depth(*less, progress, illumination)[0], seen_by, by)


def see_by_frame(source: SensorSpec, frame: TactileFrame) -> SensorSpec:
    """The sensor with the frame's own camera, where it has one."""
    return source if frame.camera is None else source.with_camera(frame.camera)


def compute_downsampling(frame: TactileFrame, source: SensorSpec, params: DepthParams) -> int:
    """Downsampling factor of a gel's frame: 1 is full resolution, drafts have more."""
    return draft_resolution.compute_downsampling(see_by_frame(source, frame).camera.shape) if params.draft else 1


def scale_params(params: AnyDepthParams, by: int) -> AnyDepthParams:
    """The parameters for images downsampled by a factor."""
    return replace(params, smoothing_px=params.smoothing_px / by)


def estimate_illumination(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, progress: Progress = SILENT
) -> Illumination:
    """The illumination of a gel's frame, by the frame's content alone; see `frame_illumination`."""
    seen_by = see_by_frame(source, frame)
    table = calibration if calibration is not None else make_built_in(seen_by)
    return frame_illumination.estimate_illumination(frame, seen_by, table, progress)


def estimate_gel_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress = SILENT,
    illumination: Illumination | None = None,
) -> tuple[DepthMap, gel_depth.MeasuredSurface | None]:
    """Depth of a gel's frame, and the surface it rests on; the frame has been checked.

    `illumination` None is the frame's own; a downsampled frame takes that of the full one.
    """
    seen_by = see_by_frame(source, frame)
    table = calibration if calibration is not None else make_built_in(seen_by)
    if illumination is None:
        illumination = frame_illumination.estimate_illumination(frame, seen_by, table, progress)
    found, measured = gel_depth.measure_gel_depth(
        frame, seen_by, table, illumination,
        no_touch_grey=source.limits.no_contact_change / params.sensitivity,
        least_mm=params.contact_limit * source.limits.contact_min_mm,
        pressure_share=params.pressure_share,
        smoothing_px=params.smoothing_px,
        boundary=params.boundary,
        progress=progress,
        draft=params.draft,
    )  # fmt: skip
    error = depth_error.predict_gel_error(found, seen_by, table, None if measured is None else measured.illumination)
    return replace(found, error=error), measured


def make_bubble_error(source: SensorSpec) -> DepthErrorModel | None:
    """Depth error in contact of a bubble sensor; None if not measured."""
    rms_mm = source.limits.depth_rms_mm
    return DepthErrorModel(rms_mm=rms_mm, correlation_mm=source.limits.depth_correlation_mm) if rms_mm else None


def estimate_depth_with_notes(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """`estimate_depth` of a recorded frame; for a gel, the first note says how good its calibration is."""
    found = estimate_depth(frame, source, calibration, params, progress)
    return found if source.optics is None else add_calibration_notes(found, frame, source, calibration)


def add_calibration_notes(
    found: DepthMap, frame: TactileFrame, source: SensorSpec, calibration: Calibration | None
) -> DepthMap:
    """A gel's result, with the quality of its calibration as the first note."""
    if calibration is None or gel_depth.NOT_SCALED in found.notes:
        quality = quality_notes.UNCALIBRATED_NOTE
    else:
        quality = quality_notes.describe_quality(calibration)
    return replace(found, notes=(quality, *warn_of_mismatch(frame, source, calibration), *found.notes))


def warn_of_mismatch(frame: TactileFrame, source: SensorSpec, calibration: Calibration | None) -> tuple[str, ...]:
    """A warning where a gel's images contradict the described LEDs that its calibration rests on."""
    mismatch = describe_mismatch(frame, source) if calibration is None or calibration.is_built_in else ""
    return (StageWarning(f"{mismatch}; depth and contact may be all wrong"),) if mismatch else ()


def describe_mismatch(frame: TactileFrame, source: SensorSpec) -> str:
    """How a gel's images differ from those of the sensor's description, as a clause; "" where they do not.

    The reference image shows most of it; on some sensors, mirroring shows only together with a touch.
    """
    if frame.is_depth or frame.reference is None:
        return ""
    seen_by = see_by_frame(source, frame)
    found = compare_colours(cast("Image", frame.reference), seen_by)
    if found.problem:
        return f"the reference image is not that of a {source.name}: {found.problem}"
    how = found.possible_mirroring
    if how is not None and looks_mirrored(frame, seen_by, make_built_in(seen_by), how):
        return f"the images look mirrored {how}: only then are the touch's slopes those of a surface"
    return ""


def skip_without_contact(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
) -> DepthMap | None:
    """The exact result for a frame without contact; None where there may be contact."""
    reference, image = frame.reference, frame.image
    if reference is None or reference.shape != image.shape or reference.dtype != image.dtype:
        return None
    kind, number = source.sensor_kind, np.floating if frame.is_depth else np.uint8
    if frame.is_depth != kind.is_depth or not np.issubdtype(image.dtype, number):  # `check_frame` refuses it
        return None
    limit = source.limits.no_contact_change / params.sensitivity
    seen_by = see_by_frame(source, frame)
    is_readable = not any(kind.find_image_problem(array) for array in (image, reference))
    if frame.image.shape[:2] != seen_by.camera.shape or not is_readable:
        return None
    check = NO_CONTACT_CHECKS.get(kind)
    notes = None if check is None else check(frame, seen_by, calibration, limit)
    if notes is None:
        return None
    at_rest = _at_rest(frame, seen_by)
    return at_rest if notes == at_rest.notes else replace(at_rest, notes=notes)


def check_frame(frame: TactileFrame, source: SensorSpec) -> None:
    """Raise ShapeError for a frame that no method can read."""
    where = f"frame {frame.index} of {frame.sensor or source.name}"
    image, reference = frame.image, frame.reference
    if reference is None:
        raise MissingReference(
            f"no reference image for {where}; record one frame without contact, or choose its image as the reference"
        )
    camera = frame.camera or source.camera
    kind = source.sensor_kind
    wanted = camera.shape if kind.is_depth else (*camera.shape, 3)
    for what, array in (("image", image), ("reference", reference)):
        if array.shape != wanted:
            raise SensorMismatch(
                f"the {what} of {where} must have shape {wanted}, got {array.shape}; choose the right sensor"
            )
        problem = kind.find_image_problem(array)
        if problem:
            raise ShapeError(f"the {what} of {where} {problem}")
    lost = 0.0 if kind.is_depth else _measure_lost_share(image, reference)
    if lost > _MAX_LOST_SHARE:
        raise ShapeError(
            f"{lost:.0%} of the image of {where} is black where its reference is not: a part of it was lost, or the "
            "light failed; leave this frame out"
        )


def _measure_lost_share(image: NDArray[Any], reference: NDArray[Any]) -> float:
    """Share of the pixels (rows, cols, 3) that are black in the image alone: no touch casts such a shadow."""
    lost = (image[..., 1] <= _BLACK_GREY) & (reference[..., 1] > _LIT_GREY)
    return float((lost & (image <= _BLACK_GREY).all(axis=2)).mean()) if lost.mean() > _MAX_LOST_SHARE else 0.0


def _at_rest(frame: TactileFrame, source: SensorSpec) -> DepthMap:
    """The result without contact: one object for each camera of a gel, and for each reference of a bubble."""
    rest = frame.reference if frame.is_depth and frame.reference is not None else source.rest_depth_mm
    shape = source.camera.shape
    return _rests.get_or_make(
        (compute_cached_digest(rest), source.camera),
        lambda: DepthMap(
            indentation_mm=freeze(np.zeros(shape, np.float32)),
            depth_mm=freeze(np.where(rest > 0, rest, np.nan).astype(np.float32)),
            contact=freeze(np.zeros(shape, np.bool_)),
            camera=source.camera,
            source_index=make_pixel_index(shape),
            notes=(_UNTOUCHED,),
        ),
    )


EstimateDepth = Callable[[TactileFrame, SensorSpec, Calibration | None, DepthParams, Progress], DepthMap]
DEPTH_ESTIMATORS: KindTable[EstimateDepth] = KindTable(
    {GelSensor: estimate_gel_frame, BubbleSensor: estimate_bubble_frame}
)
# (frame, sensor, calibration, limit in grey levels or mm) -> notes without contact; None = there may be contact
CheckContact = Callable[[TactileFrame, SensorSpec, Calibration | None, float], tuple[str, ...] | None]
NO_CONTACT_CHECKS: KindTable[CheckContact] = KindTable(
    {GelSensor: gel_depth.describe_if_no_contact, BubbleSensor: bubble_depth.describe_if_no_contact}
)
_rests: Memo[tuple[str, Camera], DepthMap] = Memo(16)
