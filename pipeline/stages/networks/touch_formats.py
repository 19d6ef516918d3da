"""Units, statistics and grids that networks of touches were trained with, one `TouchFormat` per
kind of sensor.

Input format of the paper's end-to-end networks: the change of a frame, resized to a square.

The change is that of `SensorKind.compute_relative_change`: of a gel's image in shares of full
brightness, or the displacement of a bubble's membrane toward the camera. It is normalised by the
published mean and standard deviation.
"""

from collections.abc import Callable
from functools import wraps
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.sensors.kinds import BubbleSensor, GelSensor, KindTable, get_kind
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.networks.weights import NoWeights, Weights

# of source, target and file
SelectWeights = Callable[[SensorSpec, SensorSpec, Path | None], Weights | NoWeights]


@frozen
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


SIDE = 128


def resize_to_square(changed: Floats, side: int = SIDE) -> Floats:
    """(channels, side, side) of a change (rows, cols, channels); area mean for shrinking."""
    import cv2

    rows, cols, channels = changed.shape
    interpolation = cv2.INTER_AREA if min(rows, cols) >= side else cv2.INTER_LINEAR
    small = np.asarray(cv2.resize(changed, (side, side), interpolation=interpolation), np.float32)
    return freeze(np.ascontiguousarray(small.reshape(side, side, channels).transpose(2, 0, 1)))


def resize_from_square(square_change: Floats, shape: tuple[int, int]) -> Floats:
    """The change (rows, cols, channels) of a square (channels, side, side)."""
    import cv2

    changed = cv2.resize(
        np.ascontiguousarray(square_change.transpose(1, 2, 0)),
        shape[::-1],
        interpolation=cv2.INTER_CUBIC,
    )
    return np.asarray(changed, np.float32).reshape(*shape, len(square_change))


def normalise(square_change: Floats, kind: str) -> Floats:
    """Squares (..., channels, side, side) with zero mean and unit standard deviation over the
    paper's data.
    """
    mean, std = _get_statistics(kind)
    return ((square_change - mean) / std).astype(np.float32)


def denormalise(normalised: Floats, kind: str) -> Floats:
    """Invert `normalise`."""
    mean, std = _get_statistics(kind)
    return (normalised * std + mean).astype(np.float32)


def _get_statistics(kind: str) -> tuple[Floats, Floats]:
    known = get_touch_format(kind)
    mean, std = (np.asarray(v, np.float32)[:, None, None] for v in (known.means, known.stds))
    return mean, std


def encode_image(square_change: Floats, kind: str) -> Floats:
    """Three channels in -1..1 for latent diffusion; an imprint is repeated in all channels."""
    mapped = get_touch_format(kind).image_range
    if mapped is None:
        return np.clip(square_change, -1.0, 1.0).astype(np.float32)
    share = (square_change - mapped[0]) / (mapped[1] - mapped[0])
    return np.repeat(np.clip(2.0 * share - 1.0, -1.0, 1.0).astype(np.float32), 3, axis=-3)


def decode_image(encoded: Floats, kind: str) -> Floats:
    """Invert `encode_image`; an imprint is the mean of the channels, mapped to mm (paper, steps 1
    and 2).
    """
    mapped = get_touch_format(kind).image_range
    if mapped is None:
        return encoded
    share = 0.5 * (np.clip(encoded, -1.0, 1.0).mean(axis=-3, keepdims=True) + 1.0)
    return (mapped[0] + share * (mapped[1] - mapped[0])).astype(np.float32)
