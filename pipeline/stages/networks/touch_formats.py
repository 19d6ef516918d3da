"""Units, statistics and grids that networks of touches were trained with, one `TouchFormat` per
kind of sensor.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path

from pipeline.core.errors import SettingProblem
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable, get_kind
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks.weights import NoWeights, Weights

# of source, target and file
SelectWeights = Callable[[SensorSpec, SensorSpec, Path | None], Weights | NoWeights]


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchFormat:
    """What networks get from sensors of one kind as sources, and generate of them as targets."""

    # of `SensorKind.compute_relative_change` over the paper's data, per channel
    means: tuple[float, ...]
    stds: tuple[float, ...]
    # of changes that latent diffusion maps to -1..1; None = is -1..1
    image_range: tuple[float, float] | None
    reprojected_channels: int  # of `image_condition.build_reprojected_square`
    grid_factor: int  # as target: target pixels per pixel of the working grid
    trained_pixel_mm: float  # of the working grid that the shipped weights were trained on
    indentation_unit_mm: float
    relief_unit_mm: float
    max_relief_mm: float
    residual_unit_mm: float  # about the standard deviation of the residual where it is large
    t2d2_weights: str  # shipped


GEL = TouchFormat(
    means=(-0.0082, -0.0059, -0.0066),
    stds=(0.0989, 0.0746, 0.0731),
    image_range=None,
    reprojected_channels=5,
    grid_factor=2,
    trained_pixel_mm=0.0843,
    indentation_unit_mm=0.6,
    relief_unit_mm=0.25,
    max_relief_mm=1.0,
    residual_unit_mm=0.2,
    t2d2_weights="t2d2_gelslim",
)
BUBBLE = TouchFormat(
    means=(3.82,),
    stds=(4.24,),
    image_range=(-11.6, 22.5),  # in mm, as published
    reprojected_channels=3,
    grid_factor=1,
    trained_pixel_mm=0.43,
    indentation_unit_mm=6.0,
    relief_unit_mm=0.5,
    max_relief_mm=2.0,
    residual_unit_mm=3.0,
    t2d2_weights="t2d2_bubble",
)
TOUCH_FORMATS: KindTable[TouchFormat] = KindTable({GelSensor: GEL, BubbleSensor: BUBBLE})


def get_touch_format(kind: str) -> TouchFormat:
    """The format of a kind of sensor; raises SettingProblem for a kind that has none."""
    found = TOUCH_FORMATS.get(get_kind(kind))
    if found is None:
        raise SettingProblem(f"no network translates touches of sensors of kind {kind!r}")
    return found


def answer_for_known_kinds(select: SelectWeights) -> SelectWeights:
    """A selection of weights that answers with the reason where a kind of sensor has no touch
    format.
    """

    @wraps(select)
    def select_checked(
        source: SensorSpec, target: SensorSpec, file: Path | None
    ) -> Weights | NoWeights:
        try:
            return select(source, target, file)
        except SettingProblem as problem:
            return NoWeights(why=str(problem))

    return select_checked
