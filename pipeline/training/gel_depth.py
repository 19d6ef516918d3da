"""To correct what physics reads of gels: random things on random units, seen through all that befalls pictures.

Loads no torch when it is imported: the examples are made in worker processes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.params import setting
from pipeline.stages.depth import network_input
from pipeline.training import gel_readings
from pipeline.training.gel_readings import Taught
from pipeline.training.own import Known
from pipeline.training.task import Split

if TYPE_CHECKING:
    from torch import Tensor, nn

# Indentation is told in pixels of the fields, contact is 0 or 1.
Example = dict[str, NDArray[Any]]
_UM = 115.0  # to one pixel, about, of any of the project's gels
_SEED, _HELD_OUT_SEED, _HELD_OUT_PRESSES = 20_000, 7, 400


@dataclass(frozen=True, slots=True, kw_only=True)
class GelDepth:
    """What examples are made of."""

    presses: int = setting(3000, "Presses in the pool", low=1, high=4096)
    pictures: int = setting(10_000, "Pictures of them", low=1, high=10_000_000, help="that all examples are drawn from")
    folder: str = setting("", "Folder", help="keeps the pictures for other runs; empty = worked out each time")

    def sample(self, rng: np.random.Generator) -> Example:
        """Fields, indentation (pixels) and contact of one picture, mirrored or not."""
        index = int(rng.integers(self.pictures))
        return _mirrored(rng, example(gel_readings.reading(_SEED, index, self.presses, self.folder)))

    def of_touch(self, known: Known, rng: np.random.Generator) -> Example:
        """A touch of the user's own sensor."""
        taught = gel_readings.taught(known.frame, known.source, known.indentation_mm, known.contact)
        return _mirrored(rng, example(taught))

    def held_out(self, split: Split, index: int) -> Example:
        """Pictures of presses that training does not see; of unseen tools as the simulator presses them."""
        if split == "unseen_tools":
            return example(gel_readings.tool(index))
        return example(gel_readings.reading(_HELD_OUT_SEED, index, _HELD_OUT_PRESSES))

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss of a batch and its parts."""
        from pipeline.training import gel_loss

        return gel_loss.loss(network(batch["fields"]), batch["indentation"], batch["contact"])

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How far off depth and contact are, and how far physics is alone."""
        import torch

        named: dict[str, list[float]] = {}
        for one in held_out:
            reading = network(torch.from_numpy(one["fields"])[None])
            found, surface = reading.contact[0].numpy() > 0, reading.surface[0].numpy()
            spread = _UM * np.exp(reading.log_spread[0].numpy())
            alone = (one["fields"][network_input.PRESSED] > 0.5,
                     one["fields"][network_input.SURFACE] * np.float32(network_input.SURFACE_PX))  # fmt: skip
            for name, value in {
                **_figures(one, found, surface, spread),
                **{f"physics {name}": v for name, v in _figures(one, *alone, None).items()},
            }.items():
                named.setdefault(name, []).append(value)
        return {name: float(np.mean(values)) for name, values in named.items()}


def _figures(one: Example, found: NDArray[Any], surface: NDArray[Any], spread: NDArray[Any] | None) -> dict[str, float]:
    touched, off = one["contact"] > 0, _UM * np.abs(surface - one["indentation"])
    if not touched.any():
        return {"false contacts": float(found.any())}
    named = {
        "contact IoU": np.count_nonzero(found & touched) / np.count_nonzero(found | touched),
        "error in contact, um": float(off[touched].mean()),
    }
    if not touched.all():
        named["error beside, um"] = float(off[~touched].mean())
    if spread is not None:
        named["within 90 % spread"] = float((off < 2.303 * spread)[touched].mean())
    return named


def example(of: Taught) -> Example:
    """As the loop wants it."""
    return {
        "fields": network_input.fields(of.seen), "indentation": np.asarray(of.indentation_px, np.float32),
        "contact": of.contact.astype(np.uint8),
    }  # fmt: skip


def _mirrored(rng: np.random.Generator, one: Example) -> Example:
    """The whole sensor seen in a mirror: left and right, up and down, or both."""
    for axis, slopes in zip((-1, -2), network_input.SLOPE_FIELDS, strict=True):
        if rng.random() < 0.5:
            place = one["fields"][network_input.PLACE :].copy()
            one = {name: np.ascontiguousarray(np.flip(values, axis)) for name, values in one.items()}
            one["fields"][list(slopes)] *= -1.0
            one["fields"][network_input.PLACE :] = place
    return one
