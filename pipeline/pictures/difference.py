"""A value's picture beside the truth's: what was worked out less what is true, on a scale of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.pictures.colours import ColourScale, coloured
from pipeline.pictures.picture import Picture

_SHARE = 0.2  # of a quantity's own scale, either way: errors are smaller than what they are errors of
_GREY = 50.0  # levels of a colour picture, either way


def difference(made: Picture, true: Picture, words: str = "computed less truth") -> Picture | None:
    """`made` less `true`, pixel by pixel; None where the two cannot be subtracted.

    Heights, deviations and distances in mm. Of colours the mean of the three in grey levels. How far points lie from
    an object has no difference that means anything. `words` say which is which.
    """
    if made.pixels.shape != true.pixels.shape:
        return None
    if made.values is None or true.values is None:
        if made.scale is not None or true.scale is not None:
            return None
        gap = made.pixels.mean(axis=-1, dtype=np.float32) - true.pixels.mean(axis=-1, dtype=np.float32)
        return _drawn(made, true, gap, _GREY, "grey", words)
    ours, theirs = made.scale, true.scale
    if ours is None or theirs is None or not ours.subtracts or ours.quantity != theirs.quantity:
        return None
    if made.values.shape != true.values.shape:
        return None
    limit = _SHARE * (ours.high if ours.map == "diverging" else ours.high - ours.low)
    return _drawn(made, true, (made.values - true.values).astype(np.float32), limit, ours.unit, words)


def _drawn(made: Picture, true: Picture, gap: Floats, limit: float, unit: str, words: str) -> Picture:
    scale = ColourScale(map="diverging", low=-limit, high=limit, unit=unit, quantity=words)
    known = gap[np.isfinite(gap)]
    mean = float(np.abs(known).mean()) if known.size else 0.0
    caption = f"{words}: mean {mean:.3g} {unit}" if known.size else "no pixel has both a value and a truth"
    return replace(
        made, pixels=coloured(gap, scale), values=freeze(gap), scale=scale, felt_px=true.outline_px,
        caption=f"{caption}; white: the other's contact" if true.outline_px is not None and known.size else caption,
    )  # fmt: skip
