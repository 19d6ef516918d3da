"""Colour limits fitted to a touch, for a presentation: they only widen, so that colours do not
flicker.
"""

import math
from dataclasses import replace

import numpy as np

from pipeline.views.colours import apply_colour_map
from pipeline.views.preview import Preview

_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)  # limits are one of these times a power of ten
_QUANTILE = 0.998  # of the values within the limits: single pixels of noise do not count
_LEAST_SHARE = 0.04  # of the absolute limit: noise without a touch stays pale


class FittedContrast:
    """Limits per quantity, the widest that any image so far needed."""

    def __init__(self) -> None:
        self._limits: dict[str, float] = {}

    def fit(self, *previews: Preview) -> tuple[Preview, ...]:
        """Return the images with limits that hold all of them.

        One in true colours stays as it is.
        """
        for preview in previews:
            if preview.scale is not None and preview.values is not None:
                limit = max(abs(preview.scale.low), abs(preview.scale.high))
                known = np.abs(preview.values[np.isfinite(preview.values)])
                needed = float(np.quantile(known, _QUANTILE)) if known.size else 0.0
                needed = _round_up(max(needed, _LEAST_SHARE * limit))
                key = preview.scale.quantity
                self._limits[key] = max(self._limits.get(key, 0.0), needed)
        return tuple(self._recolour(preview) for preview in previews)

    def _recolour(self, preview: Preview) -> Preview:
        scale = preview.scale
        if scale is None or preview.values is None:
            return preview
        limit = self._limits[scale.quantity]
        fitted = replace(preview, scale=replace(scale, is_fitted=True))
        return _set_limits(fitted, -limit if scale.low < 0.0 else 0.0, limit)


def share_scale(first: Preview, second: Preview) -> tuple[Preview, Preview]:
    """Return two images with limits that hold both, where they show one quantity on scales of
    other limits.
    """
    a = first.scale
    b = second.scale
    if (
        a is None
        or b is None
        or a == b
        or (a.quantity, a.unit, a.colour_map) != (b.quantity, b.unit, b.colour_map)
    ):
        return first, second
    low = min(a.low, b.low)
    high = max(a.high, b.high)
    return _set_limits(first, low, high), _set_limits(second, low, high)


def _set_limits(preview: Preview, low: float, high: float) -> Preview:
    if preview.scale is None or preview.values is None:
        return preview
    scale = replace(preview.scale, low=low, high=high)
    return replace(preview, scale=scale, pixels=apply_colour_map(preview.values, scale))


def _round_up(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(step for step in _STEPS if step * power >= value * (1.0 - 1e-9)) * power
