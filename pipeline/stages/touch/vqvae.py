"""The target's touch by the paper's baseline, a VQ-VAE: the source's change at 128 x 128 in, the target's out.

Weights of our own are shown the change where the target looks, the published ones as the source sees it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.errors import ShapeError
from pipeline.base.params import NoParams
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.graph import Skipped
from pipeline.networks import vqvae_files, weights_registry
from pipeline.networks.square_images import (
    CHANNELS,
    compute_change,
    denormalise,
    normalise,
    resize_from_square,
    resize_to_square,
)
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import photometric as depth
from pipeline.stages.touch import physical_render
from pipeline.stages.touch.depth_limit import check_depth_limit
from pipeline.stages.touch.image_condition import reproject_square
from pipeline.stages.touch.touch_from_change import make_touch_from_change
from pipeline.values.frames import TactileFrame
from pipeline.values.results import GeneratedTouch

if TYPE_CHECKING:
    from torch import nn

NOTE = "a picture alone, from the source's picture alone: no depth and no membrane is behind it"


def select_weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights of that very direction: those of a pair of sensors know no other."""
    name = f"vqvae_{source.name}_to_{target.name}"
    found = weights_registry.load_for_task(vqvae_files.TASK, name, file, vqvae_files.read_weights)
    if isinstance(found, NoWeights):
        return found
    channels = {"inputs": CHANNELS[source.kind], "outputs": CHANNELS[target.kind]}
    if any(found.config.get(name) != n for name, n in channels.items()):
        return NoWeights(why=f"the weights {found.name!r} do not take a {source.kind}'s change for a {target.kind}'s")
    return found


def generate_touch(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    network: nn.Module,
    params: NoParams,  # noqa: ARG001 - nothing to set
    progress: Progress = SILENT,
) -> GeneratedTouch | Skipped:
    """What `target` would have recorded, as far as 128 x 128 pixels tell; raises ShapeError without a reference."""
    depth.check_frame(frame, source)
    if frame.reference is None:
        raise ShapeError(f"the touch by VQ-VAE needs {source.name}'s untouched reading; give --reference")
    if depth.skip_without_contact(frame, source, calibration, depth.DepthParams()) is not None:
        return Skipped(output=physical_render.make_reference_touch(target), reason=physical_render.NO_CONTACT)
    changed = resize_to_square(compute_change(source.kind, frame.image, frame.reference))
    drawn = getattr(network, "reprojects_input", False)
    shown = reproject_square(changed, source, target, alignment) if drawn else normalise(changed, source.kind)
    made = denormalise(_run_network(network, shown), target.kind)
    if getattr(network, "half_turn", False):
        made = made[:, ::-1, ::-1]
    progress.step(1.0, "generated")
    touch = make_touch_from_change(target, resize_from_square(np.ascontiguousarray(made), target.camera.shape))
    return replace(
        touch,
        notes=(
            *depth.warn_of_mismatch(frame, source, calibration),
            *check_depth_limit(touch, source, target, alignment),
            NOTE,
        ),
    )


def _run_network(network: nn.Module, shown: Any) -> Any:
    import torch

    with torch.inference_mode():
        return network(torch.from_numpy(np.array(shown)[None])).generated[0].numpy()
