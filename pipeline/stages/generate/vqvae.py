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
from pipeline.calibration.lookup import Calibration
from pipeline.engine.graph import Skipped
from pipeline.networks import shelf, vqvae_files
from pipeline.networks.squares import CHANNELS, change, measured, normal, square, unsquared
from pipeline.networks.weights import NoWeights, Weights
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth import stage as depth
from pipeline.stages.generate import stage
from pipeline.stages.generate.picture_input import laid
from pipeline.stages.generate.pictured import touch_of
from pipeline.stages.generate.reach import deep
from pipeline.values.frames import TactileFrame
from pipeline.values.results import Touch

if TYPE_CHECKING:
    from torch import nn

NOTE = "a picture alone, from the source's picture alone: no depth and no membrane is behind it"


def weights(source: SensorSpec, target: SensorSpec, file: Path | None) -> Weights | NoWeights:
    """The weights of that very direction: those of a pair of sensors know no other."""
    name = f"vqvae_{source.name}_to_{target.name}"
    found = shelf.for_task(vqvae_files.TASK, name, file, vqvae_files.read)
    if isinstance(found, NoWeights):
        return found
    channels = {"inputs": CHANNELS[source.kind], "outputs": CHANNELS[target.kind]}
    if any(found.config.get(name) != n for name, n in channels.items()):
        return NoWeights(why=f"the weights {found.name!r} do not take a {source.kind}'s change for a {target.kind}'s")
    return found


def generate(
    frame: TactileFrame,
    source: SensorSpec,
    calibration: Calibration | None,
    alignment: Alignment,
    target: SensorSpec,
    network: nn.Module,
    params: NoParams,  # noqa: ARG001 - nothing to set
    progress: Progress = SILENT,
) -> Touch | Skipped:
    """What `target` would have recorded, as far as 128 x 128 pixels tell; raises ShapeError without a reference."""
    depth.checked(frame, source)
    if frame.reference is None:
        raise ShapeError(f"the touch by VQ-VAE needs {source.name}'s untouched reading; give --reference")
    if depth.untouched(frame, source, calibration, depth.DepthParams()) is not None:
        return Skipped(output=stage.at_rest(target), why=stage.NO_CONTACT)
    changed = square(change(source.kind, frame.image, frame.reference))
    drawn = getattr(network, "laid", False)
    shown = laid(changed, source, target, alignment) if drawn else normal(changed, source.kind)
    made = measured(_answer(network, shown), target.kind)
    if getattr(network, "half_turn", False):
        made = made[:, ::-1, ::-1]
    progress.step(1.0, "generated")
    touch = touch_of(target, unsquared(np.ascontiguousarray(made), target.camera.shape))
    return replace(touch, notes=(*depth.odd(frame, source, calibration), *deep(touch, source, target, alignment), NOTE))


def _answer(network: nn.Module, shown: Any) -> Any:
    import torch

    with torch.inference_mode():
        return network(torch.from_numpy(np.array(shown)[None])).made[0].numpy()
