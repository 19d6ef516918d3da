"""Preview of the difference between a computed value and the truth, on a scale of its own."""

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.preview import Preview

_SHARE = 0.2  # of the quantity's own scale: errors are smaller than the quantity
_LEAST_SHARE = 0.05  # minimum of a fitted scale, so that noise is not shown as an error
_GREY = 50.0  # grey levels of a colour image, either way


def compute_difference(
    computed: Preview,
    truth: Preview,
    label: str = "computed minus truth",
    *,
    fit_scale: bool = False,
) -> Preview | None:
    """Return `computed` minus `truth` pixel by pixel; None where they cannot be subtracted.

    Heights, deviations and distances in mm; of colours the mean of the three in grey levels.
    Distances to an object have no meaningful difference. `label` says which is which. With
    `fit_scale` the limit is the first round number that covers all but one per cent of the
    differences, and the preview says so; otherwise differences of all frames share one scale.
    """
    if computed.pixels.shape != truth.pixels.shape:
        return None
    if computed.values is None or truth.values is None:
        if computed.scale is not None or truth.scale is not None:
            return None
        gap = computed.pixels.mean(axis=-1, dtype=np.float32) - truth.pixels.mean(
            axis=-1, dtype=np.float32
        )
        return _make_preview(computed, truth, gap, _GREY, "grey", label)
    ours = computed.scale
    theirs = truth.scale
    if (
        ours is None
        or theirs is None
        or not ours.is_subtractable
        or ours.quantity != theirs.quantity
    ):
        return None
    if computed.values.shape != truth.values.shape:
        return None
    limit = _SHARE * (ours.high if ours.colour_map == "diverging" else ours.high - ours.low)
    gap = (computed.values - truth.values).astype(np.float32)
    small = _round_limit(gap, limit) if fit_scale else limit
    preview = _make_preview(computed, truth, gap, small, ours.unit, label, fitted=small < limit)
    caption = f"{preview.caption}; scale fitted, {small:g} of {limit:g} {ours.unit}"
    return replace(preview, caption=caption) if small < limit else preview


def _round_limit(gap: Floats, most: float) -> float:
    """Return the smallest of 1, 2 and 5 times a power of ten that covers all but one per cent of
    the differences.
    """
    known = np.abs(gap[np.isfinite(gap)])
    needed = max(float(np.percentile(known, 99.0)) if known.size else most, _LEAST_SHARE * most)
    power = 10.0 ** np.floor(np.log10(needed))
    return float(
        min(
            most, next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= needed * (1 - 1e-9))
        )
    )


def _make_preview(
    made: Preview,
    true: Preview,
    gap: Floats,
    limit: float,
    unit: str,
    words: str,
    *,
    fitted: bool = False,
) -> Preview:
    scale = ColourScale(
        colour_map="diverging", low=-limit, high=limit, unit=unit, quantity=words, is_fitted=fitted
    )
    known = gap[np.isfinite(gap)]
    mean = float(np.abs(known).mean()) if known.size else 0.0
    caption = (
        f"{words}: mean {mean:.3g} {unit}"
        if known.size
        else "no pixel has both a value and a truth"
    )
    return replace(
        made,
        pixels=apply_colour_map(gap, scale),
        values=freeze(gap),
        scale=scale,
        observed_outline_px=true.outline_px,
        caption=f"{caption}; white: the other's contact"
        if true.outline_px is not None and known.size
        else caption,
    )
