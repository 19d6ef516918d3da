"""To read gels: random things on random units, seen through all that befalls pictures.

Loads no torch when it is imported: the examples are made in worker processes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, Mask
from pipeline.base.memo import Memo
from pipeline.base.params import setting
from pipeline.engine.digests import content
from pipeline.sensors.spec import SensorSpec
from pipeline.simulation.gel_pictures import STILL, drift, pictures
from pipeline.simulation.gel_units import COLS, PIXEL_MM, ROWS, unit
from pipeline.stages.depth import network_input
from pipeline.training import gel_presses
from pipeline.training.own import Known
from pipeline.training.task import SPLITS, Split

if TYPE_CHECKING:
    from torch import Tensor, nn

# Indentation is told in pixels of the fields, contact is 0 or 1.
Example = dict[str, NDArray[Any]]
_UM = 1000.0 * PIXEL_MM  # to one pixel
_POOL_SEED = 20_000  # presses of training; those of what is held out come from others
_HELD_OUT_PRESSES = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class GelDepth:
    """What examples are made of."""

    presses: int = setting(3000, "Presses in the pool", low=1, high=4096)
    untouched: float = setting(0.12, "Share of untouched pictures", low=0.0, high=1.0)
    drifting: float = setting(0.6, "Share of touched pictures with drift", low=0.0, high=1.0)

    def sample(self, rng: np.random.Generator) -> Example:
        """Fields, indentation (pixels) and contact of one picture."""
        return self._drawn(rng, (_POOL_SEED, self.presses))

    def of_touch(self, known: Known, rng: np.random.Generator) -> Example:
        """A touch of the user's own sensor."""
        assert known.frame.reference is not None
        at = network_input.frame(known.source.camera.shape)
        touched, untouched = (at.small(picture) for picture in (known.frame.image, known.frame.reference))
        fields = network_input.fields(touched, untouched, _own_light(known.source))
        pixel_mm = known.source.pixel_mm * at.pixels
        indentation_px = at.small(known.indentation_mm[:, :, None]) / np.float32(pixel_mm)
        contact = at.small(known.contact.astype(np.float32)[:, :, None]) > 0.5
        return _mirrored(rng, example(fields, indentation_px, contact))

    def held_out(self, split: Split, index: int) -> Example:
        """Pictures of presses that training does not see; of unseen tools as the simulator presses them."""
        if split == "unseen_tools":
            from pipeline.training.gel_held_out import tool

            return tool(index)
        return self._drawn(np.random.default_rng([8, SPLITS.index(split), index]), (7, _HELD_OUT_PRESSES))

    def _drawn(self, rng: np.random.Generator, pool: tuple[int, int]) -> Example:
        if rng.random() < self.untouched:
            level = np.zeros((ROWS, COLS), np.float32)
            pressed = gel_presses.Pressed(indentation_px=level, contact=np.zeros((ROWS, COLS), np.bool_))
            drifted = drift(rng, float(rng.uniform(0.1, 1.0)))
        else:
            pressed = gel_presses.drawn(rng, pool)
            drifted = drift(rng, float(rng.exponential(0.3))) if rng.random() < self.drifting else STILL
        of = unit(rng)
        indentation_mm = np.ascontiguousarray(pressed.indentation_px * np.float32(PIXEL_MM))
        touched, untouched = pictures(rng, of, indentation_mm, pressed.contact, drifted)
        light = None if of.nominal is None else _light(of.nominal)
        fields = network_input.fields(touched, untouched, light)
        return _mirrored(rng, example(fields, pressed.indentation_px, pressed.contact))

    def loss(self, network: nn.Module, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Any]]:
        """The loss of a batch and its parts."""
        from pipeline.training import gel_loss

        return gel_loss.loss(network(batch["fields"]), batch["indentation"], batch["contact"])

    def figures(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """How far off depth and contact are."""
        import torch

        overlap, error, outside, false, sure = [], [], [], [], []
        for one in held_out:
            reading = network(torch.from_numpy(one["fields"])[None])
            found, surface = reading.contact[0].numpy() > 0, reading.surface[0].numpy()
            touched, off = one["contact"] > 0, _UM * np.abs(surface - one["indentation"])
            if not touched.any():
                false.append(float(found.any()))
                continue
            overlap.append(np.count_nonzero(found & touched) / np.count_nonzero(found | touched))
            error.append(float(off[touched].mean()))
            outside.append(float(off[~touched].mean()) if not touched.all() else 0.0)
            sure.append(float((off < 2.303 * _UM * np.exp(reading.log_spread[0].numpy()))[touched].mean()))
        named = {
            "contact IoU": overlap, "error in contact, um": error, "error beside, um": outside,
            "false contacts": false, "within 90 % spread": sure,
        }  # fmt: skip
        return {name: float(np.mean(values)) for name, values in named.items() if values}


# By the identity of the project's own sensors: the same values every time.
_described: dict[int, tuple[SensorSpec, network_input.Light]] = {}


def _light(nominal: SensorSpec) -> network_input.Light:
    known = _described.get(id(nominal))
    if known is None:
        known = nominal, network_input.light(nominal)
        if nominal.optics is not None and nominal.optics.glows:
            _described[id(nominal)] = known
    return known[1]


_own_lights: Memo[str, network_input.Light] = Memo(8)


def _own_light(source: SensorSpec) -> network_input.Light:
    return _own_lights.of(content(source), lambda: network_input.light_of(source))


def example(fields: Floats, indentation_px: Floats, contact: Mask) -> Example:
    """As the loop wants it."""
    return {
        "fields": np.asarray(fields, np.float32), "indentation": np.asarray(indentation_px, np.float32),
        "contact": contact.astype(np.uint8),
    }  # fmt: skip


def _mirrored(rng: np.random.Generator, one: Example) -> Example:
    """The whole sensor seen in a mirror: left and right, up and down, or both."""
    for axis, slope in ((-1, 9), (-2, 10)):
        if rng.random() < 0.5:
            place = one["fields"][12:].copy()
            one = {name: np.ascontiguousarray(np.flip(values, axis)) for name, values in one.items()}
            one["fields"][slope] *= -1.0
            one["fields"][12:] = place
    return one
