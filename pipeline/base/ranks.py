"""Medians and percentiles of the pixels of a mask: the values of numpy's, without its overhead for a call."""

import numpy as np

from pipeline.base.arrays import Floats, Mask


def median(values: Floats, where: Mask | None = None) -> np.float32:
    """The median of an array, or of its values in a mask `where` of the same shape, which holds at least one."""
    return percentile(values, 50.0, where)


def percentile(values: Floats, percent: float, where: Mask | None = None) -> np.float32:
    """The percentile, interpolated linearly, of an array or of its values in a mask, which holds at least one."""
    flat = np.asarray(values, np.float32).reshape(-1) if where is None else np.asarray(values, np.float32)[where]
    whole, share = divmod((flat.size - 1) * percent / 100.0, 1.0)
    low, high = int(whole), min(int(whole) + 1, flat.size - 1)
    ordered = np.partition(flat, (low, high))
    return np.float32(ordered[low] + (np.float64(ordered[high]) - ordered[low]) * share)
