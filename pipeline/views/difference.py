"""Preview of the difference between a computed value and the truth, on a scale of its own."""

from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Floats, freeze
from pipeline.views.colours import ColourScale, apply_colour_map
from pipeline.views.preview import Preview

_SHARE = 0.2  # of the quantity's own scale: errors are smaller than the quantity
_GREY = 50.0  # grey levels of a colour image, either way


def compute_difference(
    computed: Preview, truth: Preview, label: str = "computed minus truth"
) -> Preview | None:
    """Return `computed` minus `truth` pixel by pixel; None where they cannot be subtracted.

    Heights, deviations and distances in mm; of colours the mean of the three in grey levels.
    Distances to an object have no meaningful difference. `label` says which is which. Differences
    of all frames share one scale.
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
    limit = _SHARE * (ours.high if ours.colour_map == "diverging" else ours.high - ours.low)
    gap = (computed.values - truth.values).astype(np.float32)
    return _make_preview(computed, truth, gap, limit, ours.unit, label)


def _make_preview(
    made: Preview, true: Preview, gap: Floats, limit: float, unit: str, words: str
) -> Preview:
    scale = ColourScale(colour_map="diverging", low=-limit, high=limit, unit=unit, quantity=words)
    known = gap[np.isfinite(gap)]
    caption = "no pixel has both a value and a truth"
    if known.size:
        caption = f"{words}: mean {float(np.abs(known).mean()):.3g} {unit}"
        if true.outline_px is not None:
            caption += "; white: the other's contact"
    return replace(
        made,
        pixels=apply_colour_map(gap, scale),
        values=freeze(gap),
        scale=scale,
        observed_outline_px=true.outline_px,
        caption=caption,
    )
