"""Pairs whose carrying is known: strokes that a small source sees in part, and a larger target all of."""

from __future__ import annotations

import math

import cv2
import numpy as np

from pipeline.imprints.fitting import enlarge
from pipeline.imprints.transfer import ImprintPair, TransferModel, transfer_imprint

SIDE_PX = 64


def strokes(seed: int) -> np.ndarray:
    """(rows, cols) 0..1: two or three strokes from a point near the middle, out of the picture."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((SIDE_PX, SIDE_PX), np.float32)
    middle = rng.uniform(0.35, 0.65, 2) * SIDE_PX
    first = rng.uniform(0, 360)
    for turn in first + np.cumsum(rng.uniform(60, 140, rng.integers(2, 4))):
        end = middle + 2 * SIDE_PX * np.array([math.cos(math.radians(turn)), math.sin(math.radians(turn))])
        cv2.line(picture, middle.round().astype(int).tolist(), end.round().astype(int).tolist(), 1.0, 5)
    return picture


def pairs(how: TransferModel, many: int, *, noise: float = 0.05, metric: bool = False) -> list[ImprintPair]:
    """Pairs of which `how` is true, with noise on the imprints."""
    rng = np.random.default_rng(9)
    out = []
    for k in range(many):
        sizes = {"source_size": (18.0, 18.0), "target_size": (60.0, 60.0)} if metric else {
            "source_size": (1.0, 1.0), "target_size": (1.0, 1.0)}  # fmt: skip
        blank = np.zeros((SIDE_PX, SIDE_PX), np.float32)
        empty = ImprintPair(name=str(k), contact=strokes(k), imprint=blank, is_metric=metric, **sizes)
        true = enlarge(transfer_imprint(empty, how), empty)
        real = (true + noise * rng.normal(size=true.shape)).astype(np.float32)
        out.append(ImprintPair(name=str(k), contact=empty.contact, imprint=real, is_metric=metric, **sizes))
    return out
