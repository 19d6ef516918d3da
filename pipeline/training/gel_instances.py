"""To correct what physics reads of gels, their depth as a whole included: of units that differ as a lab's do.

Loads no torch when it is imported: the examples are made in worker processes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.params import setting
from pipeline.stages.depth import gel_network_input
from pipeline.training import instance_samples
from pipeline.training.instance_samples import InstanceSample

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.training.task import Example, Split

_HELD_OUT_SEED = 7
_UM_PER_MM = 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class GelInstancesTask:
    """What examples are made of."""

    n_frames: int = setting(18_000, "Readings", low=1, high=10_000_000, help="that all examples are drawn from")
    press_seed: int = setting(1, "Seed of the readings", low=0, high=2**31 - 1)
    folder: str = setting("", "Folder", help="keeps the readings for other runs; empty = worked out each time")

    def sample(self, rng: np.random.Generator) -> Example:
        """One reading, mirrored or not."""
        index = int(rng.integers(self.n_frames))
        return mirror_example(
            rng, _example(instance_samples.simulate_instance_sample(self.press_seed, index, self.folder))
        )

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Presses that training does not see; unseen tools as the simulator presses them."""
        if split == "unseen_tools":
            return _example(instance_samples.simulate_unseen_tool(index))
        return _example(instance_samples.simulate_instance_sample(_HELD_OUT_SEED, index, self.folder))

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss of a batch and its parts."""
        from pipeline.training import gel_loss

        return gel_loss.compute_loss(network(batch["fields"]), batch["indentation"], batch["contact"])

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How far off depth and contact are, and how far physics is alone."""
        import torch

        rows: list[tuple[float, ...]] = []
        for one in held_out:
            with torch.inference_mode():
                reading = network(torch.from_numpy(one["fields"])[None])
            truth, touched = one["indentation"], one["contact"] > 0
            if not touched.any():
                continue
            surface = reading.surface[0].numpy() * float(reading.log_depth_factor[0].exp())
            physical, um = one["fields"][gel_network_input.SURFACE_CHANNEL], _UM_PER_MM * float(one["depth_mm"])
            found, alone = reading.contact_logit[0].numpy() > 0, one["fields"][gel_network_input.CONTACT_CHANNEL] > 0.5
            rows.append((
                um * float(np.abs(surface - truth)[touched].mean()),
                um * float(np.abs(physical - truth)[touched].mean()),
                *(np.count_nonzero(mask & touched) / np.count_nonzero(mask | touched) for mask in (found, alone)),
            ))  # fmt: skip
        names = ("error in contact, um", "physics error in contact, um", "contact IoU", "physics contact IoU")
        return dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True)) if rows else {}


def _example(of: InstanceSample) -> Example:
    return {
        "fields": of.fields, "indentation": of.indentation, "contact": of.contact.astype(np.uint8),
        "depth_mm": np.asarray(of.depth_mm, np.float32),
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
