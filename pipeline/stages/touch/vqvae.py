"""Touch by the paper's baseline, a VQ-VAE: the source's change at 128 x 128 in, the target's out.

Shipped weights take the change resampled to the target's view, published ones the source's own
view.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.params import NoParams
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, GeneratedTouch, TargetDepth
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.depth.frame_checks import check_frame
from pipeline.stages.networks import published_weights, weights_registry
from pipeline.stages.networks.network_factory import reproducible_inference
from pipeline.stages.networks.touch_formats import (
    answer_for_known_kinds,
    denormalise,
    get_touch_format,
    normalise,
    resize_from_square,
    resize_to_square,
)
from pipeline.stages.networks.weights import NoWeights, Weights
from pipeline.stages.touch.frame_chain import check_depth_limit, make_touch_from_change
from pipeline.stages.touch.image_condition import reproject_square

if TYPE_CHECKING:
    from torch import nn

NOT_USED = (
    "the shipped VQ-VAE is farther off than physics on new objects; choose it with --weights, or "
    "fine-tune it with `train vqvae --pairs`"
)
NOTE = "image only, from the source image: no depth or membrane is used"


@answer_for_known_kinds
def select_weights(
    source: SensorSpec, target: SensorSpec, file: Path | None
) -> Weights | NoWeights:
    """The weights of this pair of sensors in this direction, if a file is given; see `NOT_USED`."""
    if file is None:
        return NoWeights(why=NOT_USED)
    found = weights_registry.load_for_task(
        published_weights.VQVAE, "", file, published_weights.read_vqvae
    )
    if isinstance(found, NoWeights):
        return found
    channels = {
        "inputs": len(get_touch_format(source.kind).means),
        "outputs": len(get_touch_format(target.kind).means),
    }
    if any(found.config.get(name) != n for name, n in channels.items()):
        return NoWeights(
            why=f"the weights {found.name!r} do not translate from a {source.kind} to a "
            f"{target.kind}"
        )
    return found


def generate_touch(
    frame: TactileFrame,
    source_depth: DepthMap,  # noqa: ARG001 - read by its guard
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    view: TargetDepth,  # noqa: ARG001 - read by its guard
    network: nn.Module,
    params: NoParams,  # noqa: ARG001 - no settings
    progress: Progress = SILENT,
) -> GeneratedTouch:
    """Generate what `target` would record of a frame in contact, at 128 x 128 pixels.

    Raises as `check_frame`.
    """
    check_frame(frame, source)
    assert frame.reference is not None  # checked
    square = resize_to_square(
        source.sensor_kind.compute_relative_change(frame.image, frame.reference)
    )
    reprojects = getattr(network, "reprojects_input", False)
    network_input = (
        reproject_square(square, source, target, alignment)
        if reprojects
        else normalise(square, source.kind)
    )
    generated = denormalise(_run_network(network, network_input), target.kind)
    if getattr(network, "half_turn", False):
        generated = generated[:, ::-1, ::-1]
    progress.step(1.0, "generated")
    touch = make_touch_from_change(
        target, resize_from_square(np.ascontiguousarray(generated), target.camera.shape)
    )
    return replace(
        touch,
        notes=(
            *depth.warn_of_mismatch(frame, source, calibration),
            *check_depth_limit(touch, source, target, alignment),
            NOTE,
        ),
    )


def _run_network(network: nn.Module, network_input: Any) -> Any:
    import torch

    with reproducible_inference():
        return network(torch.from_numpy(np.array(network_input)[None])).generated[0].numpy()
