"""Node *rest*: the sensor as it stands untouched, the same for every frame of a recording.

Frames are checked here, and kinds of sensors that measure depth themselves are answered for.
"""

from collections.abc import Callable
from typing import cast

from pipeline.calibration.calibration_table import Calibration, check_calibration, make_built_in
from pipeline.core.arrays import Floats, Image
from pipeline.core.frozen import frozen
from pipeline.core.graph import EarlyAnswer, Skipped
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.sensors.kinds import BubbleSensor, KindTable
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_depth, instance_check
from pipeline.stages.depth.depth_params import DepthParams
from pipeline.stages.depth.frame_checks import check_frame, see_by_frame
from pipeline.stages.depth.gel import coarse_light

# Of kinds that measure depth themselves; any other is a gel. Skipped where nothing touches.
EstimateDepth = Callable[
    [TactileFrame, SensorSpec, Calibration | None, DepthParams, Progress],
    DepthMap | Skipped[DepthMap],
]
DEPTH_ESTIMATORS: KindTable[EstimateDepth] = KindTable(
    {BubbleSensor: bubble_depth.estimate_bubble_frame}
)


@frozen
class RestState:
    """A gel before a touch."""

    source: SensorSpec  # with the frame's own camera
    calibration: Calibration  # the table of the sensor's description where none is given
    light: Floats  # (rows, cols, 3, 2) coarse light of the instance
    notes: tuple[str, ...]

    @property
    def pixel_mm(self) -> float:
        """Width of a pixel, by the calibration."""
        return self.calibration.pixel_mm

    @property
    def uses_illumination(self) -> bool:
        """Whether surfaces are corrected by light: not where a table was fitted to presses,
        which holds its own.
        """
        return self.calibration.is_built_in


def describe_rest(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    params: DepthParams,
    progress: Progress,
) -> RestState | Skipped[DepthMap] | EarlyAnswer[DepthMap]:
    """A gel before the touch of a frame, which is checked; the depth map of another kind of sensor.

    Raises ShapeError for a frame that cannot be read, CalibrationError for a calibration of another
    sensor.
    """
    progress.step(0.0, "comparing with the reference image")
    check_frame(frame, source)
    seen_by = see_by_frame(source, frame)
    estimate = DEPTH_ESTIMATORS.get(source.sensor_kind)
    if estimate is not None:
        found = estimate(frame, seen_by, calibration, params, progress)
        return found if isinstance(found, Skipped) else EarlyAnswer(output=found)
    image = cast("Image", frame.image)
    reference = cast("Image", frame.reference)
    table = calibration if calibration is not None else make_built_in(seen_by)
    check_calibration(table, source.name, image)
    light = coarse_light.estimate_light(frame.context_frames, reference, seen_by, table.pixel_mm)
    notes = instance_check.check_sensor_instance(table, reference)
    return RestState(source=seen_by, calibration=table, light=light, notes=notes)
