"""Stage one: how far the source sensor's surface is pushed in, and where it is touched.

A gel's image goes through the nodes of `gel.chain`; a bubble's depth image is compared with its
untouched one (`bubble_depth`).
"""

from typing import Any, cast

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Image
from pipeline.core.errors import StageWarning
from pipeline.core.graph import Skipped, chain_nodes, run_nodes
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.depth_params import DepthParams
from pipeline.stages.depth.frame_checks import see_by_frame
from pipeline.stages.depth.gel.chain import NODES, READS
from pipeline.stages.depth.gel.result import describe_reference_mismatch
from pipeline.stages.depth.gel.slopes import describe_mirroring, make_changed_image
from pipeline.stages.depth.illumination.light import FrameLight, Illumination

_run_chain = chain_nodes(NODES, READS)


def run_physics(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress,
) -> DepthMap | Skipped[DepthMap]:
    """`estimate_depth` as a method's function."""
    return _run_chain(frame, source, calibration, params, progress)


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress = SILENT,
) -> DepthMap:
    """Indentation (mm, positive toward the camera), depth and contact of a frame, in the source
    sensor's frame.

    `calibration` None stands for the table that the sensor's description implies. The frame's own
    camera is used where it has one. Raises ShapeError for a frame that cannot be read,
    CalibrationError for one of another sensor.
    """
    found = run_physics(frame, source, calibration, params, progress)
    return found.output if isinstance(found, Skipped) else found


def skip_without_contact(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None, params: DepthParams
) -> DepthMap | None:
    """The exact result for a frame without contact.

    None where there may be contact. Raises as `estimate_depth`.
    """
    found = run_nodes(
        NODES[:2], {"frame": frame, "source": source, "calibration": calibration}, params, SILENT
    )
    return found.output if isinstance(found, Skipped) else None


def estimate_gel_depth(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress = SILENT,
    illumination: Illumination | None = None,
) -> tuple[DepthMap, Illumination | None]:
    """Depth of a gel's frame, and the light that it was measured by.

    None where there was nothing to light.

    `illumination` None is the frame's own.
    """
    values: dict[str, Any] = {"frame": frame, "source": source, "calibration": calibration}
    found = run_nodes(NODES[:2], values, params, progress)
    if "depth.change" in values:
        if illumination is not None:
            table = values["depth.rest"].calibration
            values["depth.light"] = FrameLight(illumination=illumination, calibration=table)
        found = run_nodes(NODES[2:], values, params, progress)
    light = values.get("depth.light")
    return found.output if isinstance(
        found, Skipped
    ) else found, None if light is None else light.illumination


def warn_of_mismatch(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration | None
) -> tuple[str, ...]:
    """A warning where a gel's images contradict the described LEDs that its calibration rests
    on.
    """
    mismatch = (
        describe_mismatch(frame, source) if calibration is None or calibration.is_built_in else ""
    )
    return (StageWarning(f"{mismatch}; depth and contact may be all wrong"),) if mismatch else ()


def describe_mismatch(frame: TactileFrame, source: SensorSpec) -> str:
    """How a gel's images differ from those of the sensor's description, as a clause.

    "" where they do not.

    The reference image shows most of it; on some sensors, mirroring shows only together with a
    touch.
    """
    if frame.is_depth or frame.reference is None:
        return ""
    mismatch = describe_reference_mismatch(frame, see_by_frame(source, frame))
    values: dict[str, Any] = {"frame": frame, "source": source, "calibration": None}
    run_nodes(NODES[:2], values, DepthParams(), SILENT)
    if mismatch or "depth.change" not in values:
        return mismatch
    rest = values["depth.rest"]
    image = cast("Image", frame.image)
    reference = cast("Image", frame.reference)
    changed = make_changed_image(image, rest, values["depth.change"], rest.calibration)
    return describe_mirroring(reference, rest.source, changed)
