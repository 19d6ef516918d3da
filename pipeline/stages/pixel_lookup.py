"""Finds a traced pixel in the next stage."""

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Indices


def look_up_element(source_index: Indices, source_element: int) -> int:
    """The first element (flat) made from `source_element` of the previous stage; -1 if none was."""
    flat = source_index.reshape(-1)
    if 0 <= source_element < flat.size and flat[source_element] == source_element:  # most stages keep the grid
        return source_element
    matches = np.flatnonzero(flat == source_element)
    return int(matches[0]) if matches.size else -1


def to_xyz(point: NDArray[np.floating]) -> tuple[float, float, float]:
    """A point (3,) as three floats."""
    x, y, z = (float(v) for v in point)
    return x, y, z
