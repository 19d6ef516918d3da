"""What steep walls hold up, found at once.

A wall tells its slope weakly, what it stands between strongly: springs in a row, of which the weak ones give way last
when a surface is brought nearer to its slopes step by step. So the surface is first moved as a whole: scaled, its walls
alone made higher, low, middle or high up, and each of its dents by itself.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats
from pipeline.physics.slopes import slopes

_STEPPED = ((0.1, 0.5), (0.3, 0.8), (0.6, 1.0))  # from and to what share of the depth a wall is made higher
_DENTS, _DENT_SHARE = 4, 0.5  # the largest, by themselves; of the depth
_REACH = 5  # pixels, of a dent's walls
_DEEPEST = 99.5  # percentile that stands for the depth
_LEAST_MM = 0.02
_HELD = 1e-6


def raised(surface_mm: Floats, wanted: tuple[Floats, Floats], sure: Floats, pixel_mm: float) -> Floats:
    """The surface (rows, cols), moved as a whole, whose slopes come nearest to those wanted; see `poisson.nearest`."""
    shapes = _shapes(surface_mm)
    if not shapes:
        return surface_mm
    xx, xy, yy = np.ascontiguousarray(np.moveaxis(sure, 2, 0))
    steep = [slopes(shape, pixel_mm) for shape in shapes]
    pulled = [(xx * gx + xy * gy, xy * gx + yy * gy) for gx, gy in steep]
    gx, gy = slopes(surface_mm, pixel_mm)
    left = (wanted[0] - gx, wanted[1] - gy)
    normal = np.array([[_dot(a, b) for b in steep] for a in pulled])
    pull = np.array([_dot(a, left) for a in pulled])
    by = np.linalg.solve(normal + _HELD * np.trace(normal) * np.eye(len(shapes)), pull)
    return surface_mm + sum((np.float32(k) * shape for k, shape in zip(by, shapes, strict=True)), np.float32(0.0))


def _shapes(surface_mm: Floats) -> list[Floats]:
    """Ways of moving (rows, cols) a surface as a whole."""
    import cv2

    deep = float(np.percentile(surface_mm, _DEEPEST))
    if deep <= _LEAST_MM:
        return []
    stepped = [np.clip((surface_mm / np.float32(deep) - low) / (high - low), 0.0, 1.0) for low, high in _STEPPED]
    found = [surface_mm, *(np.asarray(one, np.float32) for one in stepped)]
    n, of, stats, _ = cv2.connectedComponentsWithStats(
        (surface_mm > _DENT_SHARE * deep).astype(np.uint8), connectivity=8
    )
    if n > 2:  # the background and one dent
        dents = np.asarray(of, np.int32)
        for k in 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:_DENTS]:
            alone = cv2.dilate((dents == k).astype(np.uint8), np.ones((_REACH, _REACH), np.uint8))
            found.append(np.asarray(found[2] * alone, np.float32))
    return found


def _dot(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> float:
    return sum(float((u * v).sum(dtype=np.float64)) for u, v in zip(a, b, strict=True))
