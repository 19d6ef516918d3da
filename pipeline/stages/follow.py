"""How a traced pixel is found again in a value of the usual kinds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Indices
from pipeline.stages.slot import Mark
from pipeline.values.results import DepthMap


def element_of(source_index: Indices, wanted: int) -> int:
    """The first element (flat) that was made from element `wanted` of the slot before; -1 if none was."""
    flat = source_index.reshape(-1)
    if 0 <= wanted < flat.size and flat[wanted] == wanted:  # most maps keep the grid
        return wanted
    found = np.flatnonzero(flat == wanted)
    return int(found[0]) if found.size else -1


def in_depth(slot: str, depth: DepthMap, before: Mark) -> Mark:
    """Where a pixel of a reading lies on the membrane."""
    index = element_of(depth.source_index, before.index)
    if index < 0:
        return Mark(slot=slot, index=-1, text="outside the depth map")
    row, col = divmod(index, depth.camera.cols)
    value, z = float(depth.indentation_mm[row, col]), float(depth.depth_mm[row, col])
    ray_x, ray_y = depth.camera.rays()
    if not np.isfinite(value):
        text = "no depth reading here"
    elif not depth.contact[row, col]:
        text = f"{value:.3f} mm, not in contact"
    else:
        text = f"{value:.3f} mm"
    point = (float(ray_x[col]) * z, float(ray_y[row]) * z, z) if np.isfinite(z) else None
    return Mark(slot=slot, index=index, row=row, col=col, point_mm=point, text=text)


def triple(point: NDArray[np.floating]) -> tuple[float, float, float]:
    """A point (3,) as plain numbers."""
    x, y, z = (float(v) for v in point)
    return x, y, z
