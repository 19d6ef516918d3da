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
from pipeline.stages.depth import gel_network_input
from pipeline.training import gel_samples
from pipeline.training.gel_samples import GelTrainingSample
from pipeline.training.recorded_touches import LabelledTouch
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
class GelDepthTask:
    """What examples are made of."""

    n_presses: int = setting(3000, "Presses in the pool", low=1, high=4096)
    n_images: int = setting(10_000, "Pictures of them", low=1, high=10_000_000, help="that all examples are drawn from")
    folder: str = setting("", "Folder", help="keeps the pictures for other runs; empty = worked out each time")

    def sample(self, rng: np.random.Generator) -> Example:
        """Fields, indentation and contact of a part of one picture around its contact, mirrored or not."""
        index = int(rng.integers(self.n_images))
        return crop_around_contact(rng, gel_samples.simulate_gel_sample(_SEED, index, self.n_presses, self.folder))

    def make_touch_example(self, known: LabelledTouch, rng: np.random.Generator) -> Example:
        """A touch of the user's own sensor."""
        return crop_around_contact(
            rng, gel_samples.make_gel_sample(known.frame, known.source, known.indentation_mm, known.contact)
        )

    def make_validation_example(self, split: Split, index: int) -> Example:
        """Pictures of presses that training does not see; of unseen tools as the simulator presses them."""
        if split == "unseen_tools":
            return make_example(gel_samples.simulate_unseen_tool(index))
        return make_example(gel_samples.simulate_gel_sample(_HELD_OUT_SEED, index, _HELD_OUT_PRESSES))

    def compute_loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss of a batch and its parts."""
        from pipeline.training import gel_loss

        return gel_loss.compute_scale_free_loss(network(batch["fields"]), batch["indentation"], batch["contact"])

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How far off depth and contact are, and how far physics is alone."""
        import torch

        named: dict[str, list[float]] = {}
        for one in held_out:
            reading = network(torch.from_numpy(one["fields"])[None])
            physical = one["fields"][gel_network_input.SURFACE_CHANNEL]
            found, surface = reading.contact_logit[0].numpy() > 0, reading.surface[0].numpy()
            alone = one["fields"][gel_network_input.CONTACT_CHANNEL] > 0.5
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


def make_example(
    of: GelTrainingSample, at: _Box = (slice(0, gel_network_input.ROWS), slice(0, gel_network_input.COLS))
) -> Example:
    """A part of a picture as the loop wants it."""
    deep = np.float32(gel_network_input.compute_depth_px(of.observation))
    return {
        "fields": gel_network_input.compute_channels(of.observation, at), "contact": of.contact[at].astype(np.uint8),
        "depth": np.asarray(deep), "indentation": np.asarray(of.indentation_px[at] / deep, np.float32),
    }  # fmt: skip


def crop_around_contact(rng: np.random.Generator, of: GelTrainingSample) -> Example:
    """A part of a picture around its contact, mirrored or not."""
    return mirror_example(rng, make_example(of, _part(rng, of)))


def _part(rng: np.random.Generator, of: GelTrainingSample) -> _Box:
    """A part of one size, somewhere around what is looked at when a touch is read."""
    found: list[slice] = []
    for length, seen, most in zip(
        _LOOKED_AT, gel_network_input.compute_contact_box(of.observation), of.contact.shape, strict=True
    ):
        spare = max(_ASIDE, (seen.stop - seen.start - length) // 2)
        first = (seen.start + seen.stop - length) // 2 + int(rng.integers(-spare, spare + 1))
        first = min(max(first, 0), most - length)
        found.append(slice(first, first + length))
    return found[0], found[1]


def mirror_example(rng: np.random.Generator, one: Example) -> Example:
    """The whole sensor seen in a mirror: left and right, up and down, or both."""
    for number, (axis, turned) in enumerate(zip((-1, -2), gel_network_input.SLOPE_CHANNELS, strict=True)):
        if rng.random() < 0.5:
            one = {k: np.ascontiguousarray(np.flip(v, axis)) if v.ndim else v for k, v in one.items()}
            one["fields"][[*turned, gel_network_input.POSITION_CHANNEL + number]] *= -1.0
    return one
