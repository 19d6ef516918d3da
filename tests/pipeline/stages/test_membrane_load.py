from __future__ import annotations

import numpy as np
import pytest

from pipeline.stages.depth.membrane_load import estimate_load

PIXEL_MM = 0.4
CURVATURE_PER_MM = 0.027
SHAPE = (90, 100)
NOISE_MM = 0.4  # of one reading
NEVER_SEEN_MM = 50.0


def solved(load):
    """The move (rows, cols) mm of a membrane held well beyond the image, by a plain sine
    transform.
    """
    from scipy import fft

    wide = np.pad(load, 60) * CURVATURE_PER_MM * PIXEL_MM**2
    ky, kx = (np.pi * np.arange(1, n + 1) / (n + 1) for n in wide.shape)
    wave = fft.dstn(wide, type=1) / (4 - 2 * np.cos(ky)[:, None] - 2 * np.cos(kx)[None, :])
    return np.asarray(fft.idstn(wave, type=1)[60:-60, 60:-60], np.float32)


def ring(strength=25.0, radius_px=12.0):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.where(np.abs(np.hypot(y - 45, x - 52) - radius_px) < 1.2, strength, 0.0)


def candidates():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.hypot(y - 45, x - 52) < 20


def read(moved, seen=None, **options):
    import cv2

    seen = np.ones(SHAPE, np.bool_) if seen is None else seen
    start = np.asarray(
        cv2.GaussianBlur(np.where(seen, moved, np.float32(0.0)), (0, 0), 2.0), np.float32
    )
    return estimate_load(
        moved,
        seen,
        candidates(),
        start,
        pixel_mm=PIXEL_MM,
        curvature_per_mm=CURVATURE_PER_MM,
        **options,
    )


def noisy(seed=3):
    true = solved(ring())
    return true, (true + np.random.default_rng(seed).normal(0, NOISE_MM, SHAPE)).astype(np.float32)


def test_without_noise_a_ring_presses_as_a_ring():
    found = read(solved(ring()), noise_factor=0.01)
    pressed = found.load > 6.0  # a quarter of what the ring bears
    wanted = ring() > 0
    assert pressed[wanted].all()
    assert pressed.sum() < 1.5 * wanted.sum()  # half a pixel more on each side of a line of two
    assert found.load[45, 52] < 1.0  # the middle hangs free
    # mm, a tenth of the noise of cameras
    assert np.abs(found.displacement_mm - solved(ring())).max() < 0.05


def test_under_noise_the_middle_of_a_ring_still_hangs_free():
    true, image = noisy()
    found = read(image)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    r = np.hypot(y - 45, x - 52)
    assert found.load[r < 5].mean() < 0.15 * found.load[np.abs(r - 12) < 2].mean()
    assert np.abs(found.displacement_mm - true).mean() < 0.15 * NOISE_MM


def test_the_load_never_pulls_and_stays_among_the_candidates():
    found = read(noisy()[1])
    assert found.load.min() >= 0.0
    assert not found.load[~candidates()].any()
    assert not found.load.flags.writeable


def test_pixels_that_were_not_read_are_not_used():
    true, image = noisy()
    seen = np.random.default_rng(5).random(SHAPE) > 0.1
    spoilt = np.where(seen, image, np.float32(NEVER_SEEN_MM))
    other = np.where(seen, image, np.float32(-NEVER_SEEN_MM))
    found = read(spoilt, seen)
    assert found.displacement_mm.tobytes() == read(other, seen).displacement_mm.tobytes()
    assert np.abs(found.displacement_mm - true).mean() < 0.15 * NOISE_MM


def test_an_offset_of_the_camera_is_no_load():
    true = solved(ring())
    a = read(true)
    b = read(true + np.float32(2.0))
    assert np.abs(b.load - a.load).max() < 0.02 * a.load.max()


def test_twice_the_assumed_curvature_is_half_the_load():
    image = solved(ring())
    start = np.zeros(SHAPE, np.float32)
    seen = np.ones(SHAPE, np.bool_)
    a, b = (
        estimate_load(
            image,
            seen,
            candidates(),
            start,
            pixel_mm=PIXEL_MM,
            curvature_per_mm=k * CURVATURE_PER_MM,
        ).load.sum()
        for k in (1.0, 2.0)
    )
    assert b == pytest.approx(a / 2, rel=0.1)
