"""How a traced pixel is found again in a value of the usual kinds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Indices


def look_up_element(source_index: Indices, source_element: int) -> int:
    """The first element (flat) that was made from element `wanted` of the slot before; -1 if none was."""
    flat = source_index.reshape(-1)
    if 0 <= source_element < flat.size and flat[source_element] == source_element:  # most maps keep the grid
        return source_element
    found = np.flatnonzero(flat == source_element)
    return int(found[0]) if found.size else -1


def to_xyz(point: NDArray[np.floating]) -> tuple[float, float, float]:
    """A point (3,) as plain numbers."""
    x, y, z = (float(v) for v in point)
    return x, y, z
