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

# Indentation is told in depths of the physical contact, which are `depth` pixels of the fields; contact is 0 or 1.
Example = dict[str, NDArray[Any]]
_Box = tuple[slice, slice]
_LOOKED_AT, _ASIDE = (80, 112), 12  # rows and columns of a picture that is learned from; how far off its middle
_UM = 115.0  # to one pixel, about, of any of the project's gels
_SEED, _HELD_OUT_SEED, _HELD_OUT_PRESSES = 20_000, 7, 400


@dataclass(frozen=True, slots=True, kw_only=True)
class GelDepth:
    """What examples are made of."""

    presses: int = setting(3000, "Presses in the pool", low=1, high=4096)
    pictures: int = setting(10_000, "Pictures of them", low=1, high=10_000_000, help="that all examples are drawn from")
    folder: str = setting("", "Folder", help="keeps the pictures for other runs; empty = worked out each time")

    def sample(self, rng: np.random.Generator) -> Example:
        """Fields, indentation and contact of a part of one picture around its contact, mirrored or not."""
        index = int(rng.integers(self.pictures))
        return moved(rng, gel_readings.reading(_SEED, index, self.presses, self.folder))

    def of_touch(self, known: Known, rng: np.random.Generator) -> Example:
        """A touch of the user's own sensor."""
        return moved(rng, gel_readings.taught(known.frame, known.source, known.indentation_mm, known.contact))

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
            physical = one["fields"][network_input.SURFACE]
            found, surface = reading.contact[0].numpy() > 0, reading.surface[0].numpy()
            alone = one["fields"][network_input.PRESSED] > 0.5
            for name, value in {
                **_figures(one, found, surface * _factor(surface, physical, found)),
                **{f"physics {name}": v for name, v in _figures(one, alone, physical).items()},
            }.items():
                named.setdefault(name, []).append(value)
        return {name: float(np.mean(values)) for name, values in named.items()}


def _figures(one: Example, found: NDArray[Any], surface: NDArray[Any]) -> dict[str, float]:
    touched, um = one["contact"] > 0, _UM * float(one["depth"])
    if not touched.any():
        return {"false contacts": float(found.any())}
    truth = one["indentation"]
    off, shape = np.abs(surface - truth), np.abs(surface * _factor(surface, truth, touched) - truth)
    return {
        "contact IoU": np.count_nonzero(found & touched) / np.count_nonzero(found | touched),
        "error in contact, um": um * float(off[touched].mean()),
        "error of shape, um": um * float(shape[touched].mean()),
    }


def _factor(surface: NDArray[Any], wanted: NDArray[Any], inside: NDArray[Any]) -> float:
    own = surface[inside].astype(np.float64)
    return float(own @ wanted[inside]) / max(float(own @ own), 1e-9)


def example(of: Taught, at: _Box = (slice(0, network_input.ROWS), slice(0, network_input.COLS))) -> Example:
    """A part of a picture as the loop wants it."""
    deep = np.float32(network_input.depth_px(of.seen))
    return {
        "fields": network_input.fields(of.seen, at), "contact": of.contact[at].astype(np.uint8),
        "depth": np.asarray(deep), "indentation": np.asarray(of.indentation_px[at] / deep, np.float32),
    }  # fmt: skip


def moved(rng: np.random.Generator, of: Taught) -> Example:
    """A part of a picture around its contact, mirrored or not."""
    return mirrored(rng, example(of, _part(rng, of)))


def _part(rng: np.random.Generator, of: Taught) -> _Box:
    """A part of one size, somewhere around what is looked at when a touch is read."""
    found: list[slice] = []
    for length, seen, most in zip(_LOOKED_AT, network_input.box(of.seen), of.contact.shape, strict=True):
        spare = max(_ASIDE, (seen.stop - seen.start - length) // 2)
        first = (seen.start + seen.stop - length) // 2 + int(rng.integers(-spare, spare + 1))
        first = min(max(first, 0), most - length)
        found.append(slice(first, first + length))
    return found[0], found[1]


def mirrored(rng: np.random.Generator, one: Example) -> Example:
    """The whole sensor seen in a mirror: left and right, up and down, or both."""
    for number, (axis, turned) in enumerate(zip((-1, -2), network_input.SLOPE_FIELDS, strict=True)):
        if rng.random() < 0.5:
            one = {k: np.ascontiguousarray(np.flip(v, axis)) if v.ndim else v for k, v in one.items()}
            one["fields"][[*turned, network_input.PLACE + number]] *= -1.0
    return one
