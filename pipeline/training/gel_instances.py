"""Task: correct the physical depth of gels, scale included, on sensor instances that differ as a lab's do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.params import setting
from pipeline.stages.depth import gel_network_input
from pipeline.training import instance_samples
from pipeline.training.instance_samples import InstanceSample
from pipeline.training.task import VALIDATION_SEED, StoredPresses

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

_UM_PER_MM = 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class GelInstancesTask(StoredPresses):
    """Settings of the examples."""

    n_frames: int = setting(18_000, "Frames", low=1, high=10_000_000, help="that all examples are drawn from")

    def sample(self, rng: np.random.Generator) -> Example:
        """One frame, mirrored or not."""
        index = int(rng.integers(self.n_frames))
        sample = instance_samples.simulate_instance_sample(self.press_seed, index, self.folder)
        return mirror_example(rng, _make_example(sample))

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Frames of other presses; unseen tools as the simulator presses them."""
        if split == "unseen_tools":
            return _make_example(instance_samples.simulate_unseen_tool(index))
        return _make_example(instance_samples.simulate_instance_sample(VALIDATION_SEED, index, self.folder))

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss of a batch and its terms, see `gel_loss`."""
        from pipeline.training import gel_loss

        return gel_loss.compute_loss(network(batch["fields"]), batch["indentation"], batch["contact"])

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Depth error and contact IoU of the network and of physics alone."""
        import torch

        rows: list[tuple[float, ...]] = []
        for example in held_out:
            with torch.inference_mode():
                prediction = network(torch.from_numpy(np.array(example["fields"]))[None])
            truth, contact = example["indentation"], example["contact"] > 0
            if prediction.log_depth_factor is None or not contact.any():
                continue
            surface = prediction.surface[0].numpy() * float(prediction.log_depth_factor[0].exp())
            physical, um = example["fields"][gel_network_input.SURFACE_CHANNEL], _UM_PER_MM * float(example["depth_mm"])
            predicted = prediction.contact_logit[0].numpy() > 0
            by_physics = example["fields"][gel_network_input.CONTACT_CHANNEL] > 0.5
            rows.append((
                um * float(np.abs(surface - truth)[contact].mean()),
                um * float(np.abs(physical - truth)[contact].mean()),
                *(np.count_nonzero(m & contact) / np.count_nonzero(m | contact) for m in (predicted, by_physics)),
            ))  # fmt: skip
        names = ("error in contact, um", "physics error in contact, um", "contact IoU", "physics contact IoU")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True)) if rows else {}


def _make_example(sample: InstanceSample) -> Example:
    return {
        "fields": sample.fields, "indentation": sample.indentation, "contact": sample.contact.astype(np.uint8),
        "depth_mm": np.asarray(sample.depth_mm, np.float32),
    }  # fmt: skip


def mirror_example(rng: np.random.Generator, example: Example) -> Example:
    """The example mirrored left to right, top to bottom, both or neither; each with probability 1/2.

    Slopes and positions along a mirrored axis change sign.
    """
    for number, (axis, slopes) in enumerate(zip((-1, -2), gel_network_input.SLOPE_CHANNELS, strict=True)):
        if rng.random() < 0.5:
            example = {k: np.ascontiguousarray(np.flip(v, axis)) if v.ndim else v for k, v in example.items()}
            example["fields"][[*slopes, gel_network_input.POSITION_CHANNEL + number]] *= -1.0
    return example
