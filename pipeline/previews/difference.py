"""A value's picture beside the truth's: what was worked out less what is true, on a scale of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.previews.colours import ColourScale, apply_colour_map
from pipeline.previews.preview import Preview

_SHARE = 0.2  # of a quantity's own scale, either way: errors are smaller than what they are errors of
_LEAST_SHARE = 0.05  # of that scale, where it is fitted to what is there: noise is not shown as an error
_GREY = 50.0  # levels of a colour picture, either way


def compute_difference(
    computed: Preview, truth: Preview, label: str = "computed less truth", *, fit_scale: bool = False
) -> Preview | None:
    """`made` less `true`, pixel by pixel; None where the two cannot be subtracted.

    Heights, deviations and distances in mm. Of colours the mean of the three in grey levels. How far points lie from
    an object has no difference that means anything. `words` say which is which. One whose scale `fits` has the first
    round number for a limit under which all but a hundredth lie, and says so; else differences of all frames share one.
    """
    if computed.pixels.shape != truth.pixels.shape:
        return None
    if computed.values is None or truth.values is None:
        if computed.scale is not None or truth.scale is not None:
            return None
        gap = computed.pixels.mean(axis=-1, dtype=np.float32) - truth.pixels.mean(axis=-1, dtype=np.float32)
        return _drawn(computed, truth, gap, _GREY, "grey", label)
    ours, theirs = computed.scale, truth.scale
    if ours is None or theirs is None or not ours.is_subtractable or ours.quantity != theirs.quantity:
        return None
    if computed.values.shape != truth.values.shape:
        return None
    limit = _SHARE * (ours.high if ours.colour_map == "diverging" else ours.high - ours.low)
    gap = (computed.values - truth.values).astype(np.float32)
    small = _round_limit(gap, limit) if fit_scale else limit
    drawn = _drawn(computed, truth, gap, small, ours.unit, label, fitted=small < limit)
    told = f"{drawn.caption}; scale fitted, {small:g} of {limit:g} {ours.unit}"
    return replace(drawn, caption=told) if small < limit else drawn


def _round_limit(gap: Floats, most: float) -> float:
    """The least of 1, 2 and 5 times a power of ten that all but a hundredth of the gaps lie under, within reason."""
    known = np.abs(gap[np.isfinite(gap)])
    needed = max(float(np.percentile(known, 99.0)) if known.size else most, _LEAST_SHARE * most)
    power = 10.0 ** np.floor(np.log10(needed))
    return float(min(most, next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= needed * (1 - 1e-9))))


def _drawn(
    made: Preview, true: Preview, gap: Floats, limit: float, unit: str, words: str, *, fitted: bool = False
) -> Preview:
    scale = ColourScale(colour_map="diverging", low=-limit, high=limit, unit=unit, quantity=words, is_fitted=fitted)
    known = gap[np.isfinite(gap)]
    mean = float(np.abs(known).mean()) if known.size else 0.0
    caption = f"{words}: mean {mean:.3g} {unit}" if known.size else "no pixel has both a value and a truth"
    return replace(
        made, pixels=apply_colour_map(gap, scale), values=freeze(gap), scale=scale, felt_px=true.outline_px,
        caption=f"{caption}; white: the other's contact" if true.outline_px is not None and known.size else caption,
    )  # fmt: skip
