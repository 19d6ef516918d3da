"""Medians and percentiles of pixels: what numpy gives, in a fifth of the time."""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, Mask, freeze

_BINS = 2048


def median(values: Floats, where: Mask | None = None) -> np.float32:
    """The median of the values that lie in `where`, of the same shape: one at least. None may be NaN."""
    return percentile(values, 50.0, where)


def percentile(values: Floats, percent: float, where: Mask | None = None) -> np.float32:
    """The percentile, linear between two values, of those that lie in `where`: one at least. None may be NaN."""
    from pipeline.base.rank_kernels import select_rank

    # Read-only, as the kernel is compiled anew for what can be written to.
    flat = freeze(np.ascontiguousarray(values, np.float32).reshape(-1).view())
    held = freeze((np.ones(flat.shape, np.bool_) if where is None else np.ascontiguousarray(where)).reshape(-1).view())
    whole, share = divmod((int(np.count_nonzero(held)) - 1) * percent / 100.0, 1.0)
    keys = np.empty(max(2, flat.size), np.uint32)
    select_rank(flat.view(np.uint32), held, int(whole), keys, np.empty(_BINS, np.int64))
    low, high = keys[:2].view(np.float32)
    return np.float32(low + (np.float64(high) - low) * share)
