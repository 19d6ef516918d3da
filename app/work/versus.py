"""What a column shows beside what was worked out: the truth, or the difference to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from pipeline.pictures.difference import difference
from pipeline.pictures.picture import Picture
from pipeline.stages.slot import Seen, Slot

Versus = Literal["", "truth", "difference", "wipe", "blink"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """The truth of one slot, drawn; `gap` None where the two cannot be subtracted."""

    truth: Picture
    gap: Picture | None


def beside(slot: Slot, made: Picture, truths: Mapping[str, Any], seen: Seen) -> Beside | None:
    """The truth's picture, made as the slot's own is; None where the recording does not know it."""
    if slot.name not in truths:
        return None
    true = slot.picture(truths[slot.name], replace(seen, outputs={**seen.outputs, **truths}))
    return Beside(truth=replace(true, caption=f"truth: {true.caption}"), gap=difference(made, true))
