"""A gel's depth map: indentation within the sensor's range, expected error, and notes."""

from dataclasses import replace
from typing import cast

import numpy as np

from pipeline.calibration import quality_notes
from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.errors import AT_BORDER, StageWarning, UncertainContact
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_depth_map
from pipeline.physics.reference_colours import compare_colours
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import depth_error
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.illumination.light import Illumination

_FULL_SHARE = 0.9  # of the view: the contact leaves too little of the gel at rest
NOT_SCALED = (
    "the light is fitted to this touch: the depth scale of the calibration does not apply to it"
)


def make_gel_depth(
    indentation: Floats,
    touched: Mask,
    frame: TactileFrame,
    rest: RestState,
    notes: tuple[str, ...],
    *,
    calibration: Calibration | None = None,
    illumination: Illumination | None = None,
    mirroring: str = "",
) -> DepthMap:
    """A depth map of an indentation (rows, cols) in mm, which is cut to the sensor's range in
    place.

    `calibration` and `illumination` are what it was measured by; None where no light was needed.
    `mirroring` as `mirror_check.describe_mirroring` returns it. The first notes say how good the
    calibration is.
    """
    source = rest.source
    table = rest.calibration
    notes = (
        *rest.notes,
        *notes,
        *_limit_depth(indentation, touched, source.limits.indentation_max_mm),
    )
    depth = make_depth_map(source.rest_depth_mm, indentation, touched, source.camera, notes)
    error = depth_error.predict_gel_error(depth, source, calibration or table, illumination)
    is_described = not table.presses or NOT_SCALED in notes
    quality = (
        quality_notes.UNCALIBRATED_NOTE if is_described else quality_notes.describe_quality(table)
    )
    mismatch = describe_reference_mismatch(frame, source) or mirroring
    odd = (
        (StageWarning(f"{mismatch}; depth and contact may be all wrong"),)
        if mismatch and table.is_built_in
        else ()
    )
    return replace(depth, error=error, notes=(quality, *odd, *notes))


def describe_reference_mismatch(frame: TactileFrame, source: SensorSpec) -> str:
    """How a gel's reference image differs from that of the sensor's description, as a clause.

    "" where it does not.
    """
    problem = (
        ""
        if source.optics is None
        else compare_colours(cast("Image", frame.reference), source).problem
    )
    return f"the reference image is not that of a {source.name}: {problem}" if problem else ""


def _limit_depth(indentation: Floats, touched: Mask, largest_mm: float) -> list[str]:
    """Cut the indentation (rows, cols) in place to the sensor's range.

    Returns notes on the range and the contact.
    """
    notes: list[str] = []
    beyond = indentation > largest_mm
    if beyond.any():
        cut = (
            f"{int(beyond.sum())} pixels were deeper than the sensor's {largest_mm:g} mm and "
            "were cut to that"
        )
        notes.append(StageWarning(cut))
        np.minimum(indentation, np.float32(largest_mm), out=indentation)
    edge = np.concatenate([touched[0], touched[-1], touched[:, 0], touched[:, -1]])
    if touched.sum() > _FULL_SHARE * touched.size:
        notes.append(
            StageWarning(
                "the contact fills the view: its depth is estimated from the little gel around it"
            )
        )
    elif edge.any():
        notes.append(AT_BORDER)
    if not touched.any() and indentation.any():
        notes.append(
            UncertainContact(
                "contact uncertain: the image has changed, but nothing presses hard enough"
            )
        )
    return notes
