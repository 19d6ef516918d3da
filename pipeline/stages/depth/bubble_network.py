"""Depth of a bubble by a network: the membrane, the object's own surface, contact, and their
expected error.

The photometric counterpart (`bubble_contact`) finds the load behind a noisy membrane; the network
was trained on many objects and noises. It works on pixels of about `WORKING_PIXEL_MM`; other depth
images are resampled there and back.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.arrays import Floats, Mask, freeze
from pipeline.core.errors import AT_BORDER
from pipeline.core.frozen import frozen
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import bubble_depth, contact
from pipeline.stages.depth.bubble_depth import compute_displacement, make_bubble_error
from pipeline.stages.depth.bubble_network_input import (
    WORKING_PIXEL_MM,
    estimate_rest_surface,
    make_network_input,
)
from pipeline.stages.depth.bubble_network_output import BubblePrediction, decode_prediction
from pipeline.stages.depth.depth_params import DepthParams
from pipeline.stages.depth.frame_checks import check_frame, see_by_frame
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import NoWeights, Weights

# (N_CHANNELS, rows, cols) -> one output (N_OUTPUTS, rows, cols)
BubbleNetwork = Callable[[Floats], tuple[Floats, ...]]
# pixels up to this factor finer or coarser than `WORKING_PIXEL_MM` are in the training data
_SCALE_TOLERANCE = 1.4
_ISLAND_MM2 = 2.0  # smaller contacts are noise
_HALF = 0.5


KINDS = ("bubble",)  # of the sensors that it is for
_TASK = "bubble_depth"


@frozen
class NetworkParams(DepthParams):
    """Parameters of the depth of a bubble, and the contact threshold of the network."""

    smoothing_px: float = setting(
        1.0,
        "Smoothing",
        unit="px",
        low=0.0,
        high=5.0,
        step=0.25,
        help="blur of the colour change",
        source="a Gaussian's standard deviation; its size is our choice",
        only="gel",
    )
    certainty: float = setting(
        0.4,
        "Contact probability",
        unit="share",
        low=0.05,
        high=0.95,
        step=0.05,
        help="pixels that the network holds for contact with a higher probability are contact",
        source="measured: best overlap on simulated tools of 0.3, 0.4 and 0.5",
    )


def select_weights(
    _source: SensorSpec, _target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The weights for a bubble: one network for all of them."""
    return weights_registry.load_for_task(_TASK, _TASK, file)


def skip_without_contact(
    frame: TactileFrame,
    source: SensorSpec,
    _calibration: Calibration | None,
    _weights: Weights | NoWeights,
    params: NetworkParams,
) -> DepthMap | None:
    """The exact depth of a frame without contact; None where something may touch.

    Raises ShapeError for an invalid frame.
    """
    check_frame(frame, source)
    return bubble_depth.skip_without_contact(frame, see_by_frame(source, frame), params)


def estimate_frame(
    frame: TactileFrame,
    source: SensorSpec,
    _calibration: Calibration | None,
    network: BubbleNetwork,
    params: NetworkParams,
    _progress: Progress = SILENT,
) -> DepthMap:
    """The depth of a checked frame with the physical estimate's error in contact."""
    seen_by = see_by_frame(source, frame)
    least_mm = params.contact_limit * source.limits.contact_min_mm
    depth = estimate_depth(frame, seen_by, network, certainty=params.certainty, least_mm=least_mm)
    return replace(depth, error=make_bubble_error(source))


def estimate_depth(
    frame: TactileFrame,
    source: SensorSpec,
    network: BubbleNetwork,
    *,
    certainty: float = _HALF,
    least_mm: float,
) -> DepthMap:
    """The depth of one checked bubble frame as the network predicts it.

    Contact is where its probability is above `certainty` and the membrane moved by more than
    `least_mm`. `object_depth_mm` is the object's surface in contact: around it the network also
    predicts one, but a gel touches less of that than it leaves out (docs/experiments.md).
    `expected_error_mm` is the error of the object's surface and, elsewhere, of the membrane.
    """
    assert frame.reference is not None  # checked
    notes: list[str] = []
    moved, rest, measured, known = compute_displacement(
        frame.reference, frame.image, source.limits.indentation_max_mm, notes
    )
    prediction = _predict(moved, rest, measured, source.pixel_mm, network)
    islands = max(4, round(_ISLAND_MM2 / source.pixel_mm**2))
    moves = prediction.displacement_mm > least_mm
    touched = contact.remove_specks((prediction.contact > certainty) & known & moves, islands)
    if not touched.any():
        notes.append("nothing touches the sensor")
    elif contact.reaches_border(touched):
        notes.append(AT_BORDER)
    nothing = np.float32(np.nan)
    rest = estimate_rest_surface(rest, measured, source.pixel_mm)  # without the reference's noise
    return DepthMap(
        indentation_mm=freeze(np.where(known, prediction.displacement_mm, nothing)),
        depth_mm=freeze(np.where(known, rest - prediction.displacement_mm, nothing)),
        contact=freeze(touched),
        camera=source.camera,
        source_index=make_pixel_index(moved.shape),
        notes=tuple(notes),
        object_depth_mm=freeze(
            np.where(touched, rest - prediction.object_displacement_mm, nothing)
        ),
        expected_error_mm=freeze(np.where(known, prediction.expected_error_mm, nothing)),
        measured_depth_mm=freeze(np.where(measured, frame.image, nothing).astype(np.float32)),
    )


def _predict(
    moved: Floats, rest: Floats, measured: Mask, pixel_mm: float, network: BubbleNetwork
) -> BubblePrediction:
    """The network's prediction on the pixels of the frame."""
    (rows, cols), scale = moved.shape, pixel_mm / WORKING_PIXEL_MM
    size = rows, cols
    if not 1 / _SCALE_TOLERANCE < scale < _SCALE_TOLERANCE:
        size = max(8, round(rows * scale)), max(8, round(cols * scale))
    small_measured = _resize(measured.astype(np.float32), size) > _HALF
    inputs = make_network_input(
        _resize(moved, size), _resize(rest, size), small_measured, pixel_mm * rows / size[0]
    )
    (output,) = network(inputs.channels)
    prediction = decode_prediction(output, inputs.smooth_displacement_mm)
    return BubblePrediction(*(_resize(field, (rows, cols)) for field in prediction))


def _resize(image: Floats, size: tuple[int, int]) -> Floats:
    """An image (rows, cols) at another size."""
    import cv2

    if image.shape == size:
        return image
    kind = cv2.INTER_AREA if size[0] < image.shape[0] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size[::-1], interpolation=kind), np.float32)
