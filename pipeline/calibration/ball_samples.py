"""Pixels with known slopes from presses of a ball, for calibration tables and the shading field."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats
from pipeline.calibration import slope_model
from pipeline.calibration.ball_slopes import RING_RADII, TRUSTED_RADIUS_SHARE, BallPress, BallSlopeProfile
from pipeline.calibration.shading_field import SurfaceSamples, compute_shading_terms
from pipeline.calibration.slope_model import SlopeSamples

_RING_WEIGHT = 0.3  # of a pixel outside the trusted contact: its slope comes from the other presses
_CONTACT_PIXELS, _RIM_PIXELS, _UNTOUCHED_PIXELS = 1000, 600, 400  # per press
_FULL_PRESSES_MAX = 16  # with more presses, each gives fewer pixels
_UNTOUCHED_RADII = 2.5  # contact radii from the centre


def sample_surface(
    press: BallPress, ball: BallSlopeProfile, pixel_mm: float, rng: np.random.Generator
) -> SurfaceSamples:
    """Pixels of the trusted contact with their indentation.

    At the contact's edge, radius a, the indentation of an elastic body is a^2 / 2R (Hertz), in the centre twice that.
    """
    where = _find_zones(press)[0]
    where = rng.choice(where, min(_CONTACT_PIXELS, len(where)), replace=False)
    samples, distance_px = _sample(press, ball, where)
    deep_px = (press.circle.radius_px**2 - 0.5 * distance_px**2) / ball.radius_px
    parts = compute_shading_terms(samples.slopes.astype(np.float64), deep_px * pixel_mm)
    return SurfaceSamples(u=samples.u, v=samples.v, shading_terms=parts, change=samples.change)


def sample_contact(press: BallPress, ball: BallSlopeProfile) -> SlopeSamples:
    """All pixels of the trusted contact."""
    return _sample(press, ball, _find_zones(press)[0])[0]


def gather_contact_slopes(press: BallPress, gx: Floats, gy: Floats) -> Floats:
    """Slopes (n, 2) of two images (rows, cols) at the pixels of `sample_contact`."""
    where = _find_zones(press)[0]
    return np.stack([gx.ravel()[where], gy.ravel()[where]], axis=1)


def sample_presses(
    presses: Sequence[BallPress], ball: BallSlopeProfile, rng: np.random.Generator
) -> tuple[SlopeSamples, Floats]:
    """Pixels of the contacts, of their rims where the profile is known, and untouched ones, with weights (n,)."""
    parts: list[SlopeSamples] = []
    weights: list[Floats] = []
    share = min(1.0, _FULL_PRESSES_MAX / len(presses))
    sizes = [round(share * n) for n in (_CONTACT_PIXELS, _RIM_PIXELS, _UNTOUCHED_PIXELS)]
    for press in presses:
        zones = [rng.choice(z, min(n, len(z)), replace=False) for z, n in zip(_find_zones(press), sizes, strict=True)]
        parts.append(_sample(press, ball, np.concatenate(zones))[0])
        weights.append(np.repeat((1.0, _RING_WEIGHT, 1.0), [len(z) for z in zones]).astype(np.float32))
    return concatenate_samples(parts), np.concatenate(weights)


def concatenate_samples(parts: Sequence[SlopeSamples]) -> SlopeSamples:
    """The samples of all parts as one."""
    return SlopeSamples(
        change=np.concatenate([s.change for s in parts]), u=np.concatenate([s.u for s in parts]),
        v=np.concatenate([s.v for s in parts]), slopes=np.concatenate([s.slopes for s in parts]),
    )  # fmt: skip


def _find_zones(press: BallPress) -> tuple[NDArray[np.intp], ...]:
    """Flat indices of the trusted contact's pixels, of the rim's, and of untouched ones."""
    rows, cols = press.change.shape[:2]
    c = press.circle
    distance = np.hypot((np.arange(cols) - c.x_px)[None, :], (np.arange(rows) - c.y_px)[:, None]) / c.radius_px
    rim = (distance >= TRUSTED_RADIUS_SHARE) & (distance < RING_RADII[-1])
    return tuple(np.flatnonzero(m) for m in (distance < TRUSTED_RADIUS_SHARE, rim, distance > _UNTOUCHED_RADII))


def _sample(press: BallPress, ball: BallSlopeProfile, where: NDArray[np.intp]) -> tuple[SlopeSamples, Doubles]:
    """Pixels (flat indices) with the ball's slopes, and their distance from its centre in px."""
    rows, cols = press.change.shape[:2]
    row, col = np.divmod(where, cols)
    dx, dy = col - press.circle.x_px, row - press.circle.y_px
    r = np.maximum(np.hypot(dx, dy), 1e-6)
    fall = ball.compute_slope(r, press.circle.radius_px) / r
    u, v = slope_model.compute_positions((rows, cols))
    slopes = np.stack([-dx * fall, -dy * fall], axis=1).astype(np.float32)
    return SlopeSamples(change=press.change[row, col], u=u[col], v=v[row], slopes=slopes), r
