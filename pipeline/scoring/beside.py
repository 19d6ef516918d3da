"""What a column shows beside what was worked out: the truth, or the difference to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from pipeline.pictures.difference import difference
from pipeline.pictures.display import DisplayParams
from pipeline.pictures.layers import Layer
from pipeline.pictures.picture import Picture, of_heights
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.slot import Seen, Slot
from pipeline.values.results import DepthMap

Versus = Literal["", "truth", "difference", "wipe", "blink"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """The truth of one slot, drawn; `gap` None where the two cannot be subtracted."""

    truth: Picture
    gap: Picture | None
    layers: tuple[Layer, ...] = ()  # of the truth


def beside_felt(made: Picture, felt: DepthMap, target: SensorSpec, display: DisplayParams) -> Beside:
    """What an alignment carries over beside what the target felt itself, measured as any reading is."""
    own = of_heights(felt.indentation_mm, felt.depth_mm, felt.contact, felt.camera, target, display)
    gap = difference(made, own, words="carried over less felt", fits=True)
    return Beside(truth=replace(own, caption=f"felt by {target.name} itself"), gap=gap)


def beside(slot: Slot, made: Picture, truths: Mapping[str, Any], seen: Seen) -> Beside | None:
    """The truth's picture, made as the slot's own is; None where the recording does not know it."""
    if slot.name not in truths:
        return None
    known = replace(seen, outputs={**seen.outputs, **truths})
    true = slot.picture(truths[slot.name], known)
    return Beside(
        truth=replace(true, caption=f"truth: {true.caption}"), gap=difference(made, true),
        layers=slot.layers(truths[slot.name], known, true),
    )  # fmt: skip
