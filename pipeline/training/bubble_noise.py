"""What a depth camera makes of a pressed bubble: two readings, one of them untouched, with all that real ones err by.

Beyond the noise of the description: units that see better or worse, a pattern that stays (the membrane's own texture),
blobs of false matches, membranes that do not come back all the way, borders and holes without a reading.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from pipeline.base.arrays import Floats, freeze
from pipeline.physics import bubble_camera
from pipeline.sensors.spec import DepthCamera, SensorSpec, load_sensor
from pipeline.training.bubble_presses import BubblePress

_WORST, _BEST = 2.0, 0.12  # times the described noise: Punyo's stereo camera is the best of those looked at


def simulate_noisy_depth_pair(
    pressed: BubblePress, rng: np.random.Generator, *, plain: bool = False
) -> tuple[Floats, Floats]:
    """(untouched, touched) depth (rows, cols) in mm, NaN = no reading; `plain`: with the description's noise alone."""
    unit, shape = _camera(pressed.sensor, rng, plain), pressed.indentation_mm.shape
    rest = unit.rest_depth_mm.astype(np.float64)
    now = rest - pressed.indentation_mm
    if not plain:
        still = _texture(rng, shape) if rng.random() < 0.4 else np.float32(0.0)
        untouched = not pressed.contact.any()
        if untouched or rng.random() < 0.35:
            now = now - _drift(rng, shape, 1.3 if untouched else 0.25)
        if rng.random() < 0.4:
            now = now - _blobs(rng, shape)
        rest, now = rest + still, now + still
    seeds = rng.integers(0, 1 << 62, 2)
    cosines = (bubble_camera.compute_rest_cosine(unit), pressed.incidence_cosine)
    first, second = (
        np.array(bubble_camera.simulate_depth_frame(unit, depth, int(seed), cosine=cosine))
        for depth, seed, cosine in zip((rest, now), seeds, cosines, strict=True)
    )
    if not plain and rng.random() < 0.25:  # the mean of several untouched readings
        first += np.float32(rng.uniform(0.2, 0.8)) * (rest - first).astype(np.float32)
    if not plain and rng.random() < 0.3:
        lost = _lost(rng, shape)
        first[lost], second[lost] = np.nan, np.nan
    return freeze(first), freeze(second)


def _camera(unit: SensorSpec, rng: np.random.Generator, plain: bool) -> SensorSpec:
    """The unit with a time-of-flight or a stereo camera, better or worse than described."""
    assert unit.bubble is not None
    errs = _depth_camera("soft_bubble" if rng.random() < 0.5 else "soft_bubble_stereo")
    if plain or errs is None:
        return replace(unit, depth_camera=errs)
    times = float(np.clip(np.exp(rng.normal(-0.1, 0.5)), _BEST, _WORST))
    grain = errs.grain_px * rng.uniform(0.6, 1.5)
    worse = replace(unit.bubble, depth_noise_mm=times * unit.bubble.depth_noise_mm)
    return replace(unit, bubble=worse, depth_camera=replace(errs, grain_px=grain))


@lru_cache(maxsize=2)
def _depth_camera(name: str) -> DepthCamera | None:
    return load_sensor(name).depth_camera


def _field(rng: np.random.Generator, shape: tuple[int, ...], length_px: float) -> Floats:
    """A smooth random field of mean 0 and deviation 1."""
    import cv2

    few = max(2, int(min(shape) / max(length_px, 1.0)))
    coarse = rng.standard_normal((few + 2, few + 2)).astype(np.float32)
    whole = np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)
    return (whole - whole.mean()) / max(float(whole.std()), 1e-6)


def _texture(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """A pattern that every reading of a unit shows."""
    return rng.uniform(0.02, 0.3) * _field(rng, shape, rng.uniform(1.5, 8.0))


def _drift(rng: np.random.Generator, shape: tuple[int, ...], most_mm: float) -> Floats:
    """A membrane that hangs elsewhere than before: waves as long as itself, a hump that stays, air that was let in."""
    wave = rng.uniform(0.0, 0.35) * _field(rng, shape, rng.uniform(40.0, 90.0))
    rows, cols = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in shape)
    (cy, cx), width = rng.uniform(-0.8, 0.8, 2), rng.uniform(0.2, 0.7)
    away = ((rows[:, None] - cy) ** 2 + (cols[None, :] - cx) ** 2) / width**2
    hump = rng.uniform(-0.6, 1.0) * np.exp(-0.5 * away)
    air = rng.uniform(-0.4, 0.4) * (1.0 - 0.7 * rows[:, None] ** 2 - 0.7 * cols[None, :] ** 2)
    return (most_mm * rng.random() * (wave + hump + air)).astype(np.float32)


def _blobs(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """False matches that hang together over some pixels."""
    found = np.zeros(shape, np.float32)
    for _ in range(rng.integers(1, 9)):
        row, col, width = rng.uniform(0, shape[0]), rng.uniform(0, shape[1]), rng.uniform(0.8, 4.0, 2)
        y, x = np.arange(shape[0], dtype=np.float32) - row, np.arange(shape[1], dtype=np.float32) - col
        height = rng.uniform(-1.5, 1.5)
        found += height * np.exp(-0.5 * ((y[:, None] / width[0]) ** 2 + (x[None, :] / width[1]) ** 2))
    return found


def _lost(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Where a unit reads nothing: beyond a ragged border, and in holes."""
    rows, cols = (np.linspace(-1.0, 1.0, n) for n in shape)
    out = np.hypot(rows[:, None] - rng.uniform(-0.2, 0.2), cols[None, :] - rng.uniform(-0.2, 0.2))
    lost = out + 0.1 * _field(rng, shape, rng.uniform(6.0, 20.0)) > rng.uniform(0.9, 1.6)
    holes = _field(rng, shape, rng.uniform(3.0, 8.0)) > rng.uniform(2.0, 4.0)
    return np.asarray(lost | holes, np.bool_)
