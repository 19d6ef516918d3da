"""What steep walls hold up, found at once.

A wall tells its slope weakly, what it stands between strongly: springs in a row, of which the weak ones give way last
when a surface is brought nearer to its slopes step by step. So the surface is first moved as a whole: scaled, its walls
alone made higher, low, middle or high up, and each of its dents by itself.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.base.ranks import percentile
from pipeline.physics.slopes import compute_slopes
from pipeline.stages.depth.poisson import split_weights

_STEPPED = ((0.1, 0.5), (0.3, 0.8), (0.6, 1.0))  # from and to what share of the depth a wall is made higher
_DENTS, _DENT_SHARE = 4, 0.5  # the largest, by themselves; of the depth
_REACH = 5  # pixels, of a dent's walls
_DEEPEST = 99.5  # percentile that stands for the depth
_LEAST_MM = 0.02
_HELD = 1e-6


def raise_walls(surface_mm: Floats, wanted: tuple[Floats, Floats], sure: Floats, pixel_mm: float) -> Floats:
    """The surface (rows, cols), moved as a whole, whose slopes come nearest to those wanted; see `poisson.nearest`."""
    import cv2

    from pipeline.stages.depth.illumination.wall_correction_kernels import accumulate_normal_equations

    shapes = _shapes(surface_mm)
    if not shapes:
        return surface_mm
    n, cols = len(shapes), surface_mm.shape[1]
    normal, pull, line = np.empty((n, n)), np.empty(n), np.empty((2, cols), np.float32)
    steep = (*compute_slopes(np.stack(shapes), pixel_mm), *wanted)
    # Read-only, as the kernel is compiled anew for what can be written to.
    accumulate_normal_equations(
        *(freeze(np.ascontiguousarray(g, np.float32).view()) for g in steep), *split_weights(sure), line, normal, pull
    )
    by = np.linalg.solve(normal + _HELD * np.trace(normal) * np.eye(n), pull)
    raised_mm = np.array(surface_mm, np.float32)
    for k, shape in zip(by, shapes, strict=True):
        cv2.scaleAdd(shape, float(k), raised_mm, dst=raised_mm)
    return raised_mm


def _shapes(surface_mm: Floats) -> list[Floats]:
    """Ways of moving (rows, cols) a surface as a whole."""
    import cv2

    deep = float(percentile(surface_mm, _DEEPEST))
    if deep <= _LEAST_MM:
        return []
    found = [surface_mm, *(_stepped(surface_mm, deep, low, high) for low, high in _STEPPED)]
    n, of = cv2.connectedComponents((surface_mm > _DENT_SHARE * deep).astype(np.uint8), connectivity=8)
    if n > 2:  # the background and one dent
        dents = np.asarray(of, np.int32)
        areas = np.bincount(dents.ravel(), minlength=n)[1:]
        for k in 1 + np.argsort(-areas, kind="stable")[:_DENTS]:
            alone = cv2.dilate((dents == k).astype(np.uint8), np.ones((_REACH, _REACH), np.uint8))
            found.append(np.asarray(found[2] * alone, np.float32))
    return found


def _stepped(surface_mm: Floats, deep_mm: float, low: float, high: float) -> Floats:
    """From 0 to 1 where the surface (rows, cols) goes from one share of the depth to the other."""
    out = surface_mm * np.float32(1.0 / (deep_mm * (high - low)))
    out -= np.float32(low / (high - low))
    np.maximum(out, np.float32(0.0), out=out)
    return np.minimum(out, np.float32(1.0), out=out)
