"""Presses of a ball: the slopes around one, the circle that fits measured slopes, and pixels with
known slopes.

The pixels are what calibration tables and the shading field are fitted to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import slope_model
from pipeline.calibration.contact_circles import Circle, compute_ring_profile
from pipeline.calibration.shading_field import SurfaceSamples, compute_shading_terms
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.core.arrays import Doubles, Floats

TRUSTED_RADIUS_SHARE = 0.85  # of the contact's radius: inside it the rim's blur has no effect
# radii over the contact radius at which the slope profile is tabulated
RING_RADII = np.arange(0.0, 2.001, 0.05)


@dataclass(frozen=True, slots=True, kw_only=True)
class BallPress:
    """One image of a press."""

    index: int
    change: Floats  # (rows, cols, 3)
    circle: Circle


@dataclass(frozen=True, slots=True, kw_only=True)
class BallSlopeProfile:
    """Radial slope profile of a press: the sphere's slope times a share that accounts for the
    rim.
    """

    radius_px: float
    # at `RING_RADII`; None = unknown outside the trusted contact
    sphere_slope_share: Doubles | None

    def compute_slope(self, distance_px: Doubles, contact_px: float) -> Doubles:
        """Slope toward the centre, mm/mm."""
        r = np.minimum(distance_px, 0.95 * self.radius_px)
        sphere = r / np.sqrt(self.radius_px**2 - r * r)
        t = distance_px / contact_px
        if self.sphere_slope_share is None:
            return np.where(t < TRUSTED_RADIUS_SHARE, sphere, 0.0)
        return sphere * np.where(
            t < TRUSTED_RADIUS_SHARE,
            1.0,
            np.interp(t, RING_RADII, self.sphere_slope_share, right=0.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Neighbourhood:
    """Slopes by a calibration table around one press."""

    x: Doubles  # (1, cols) of the image
    y: Doubles  # (rows, 1)
    gx: Floats  # (rows, cols)
    gy: Floats


def _evaluate_around(model: SlopeModel, press: BallPress) -> _Neighbourhood:
    c = press.circle
    rows, cols = press.change.shape[:2]
    reach = RING_RADII[-1] * c.radius_px + 4.0
    r0, r1 = (min(max(0, round(c.y_px + d * reach)), rows) for d in (-1, 1))
    c0, c1 = (min(max(0, round(c.x_px + d * reach)), cols) for d in (-1, 1))
    u, v = slope_model.compute_positions((rows, cols))
    part = np.ascontiguousarray(press.change[r0:r1, c0:c1])
    gx, gy = slope_model.evaluate(
        model, part, u[c0:c1], v[r0:r1], np.ones(part.shape[:2], np.bool_)
    )
    return _Neighbourhood(
        x=np.arange(c0, c1, dtype=np.float64)[None, :],
        y=np.arange(r0, r1, dtype=np.float64)[:, None],
        gx=gx,
        gy=gy,
    )


def _compute_radial_slopes(around: _Neighbourhood, circle: Circle) -> tuple[Floats, Doubles]:
    """(slope toward the centre, distance from it) of every pixel around a press."""
    dx = around.x - circle.x_px
    dy = around.y - circle.y_px
    distance = np.maximum(np.hypot(dx, dy), 1e-6)
    return (-(around.gx * dx + around.gy * dy) / distance).astype(np.float32), distance


def refine_circle(model: SlopeModel, press: BallPress, ball: BallSlopeProfile) -> Circle:
    """The contact circle that fits the slopes of a calibration table."""
    c = press.circle
    around = _evaluate_around(model, press)
    x = around.x
    y = around.y
    gx = around.gx
    gy = around.gy
    if ball.sphere_slope_share is not None:
        return _fit_circle(around, c, ball)
    inside = np.hypot(x - c.x_px, y - c.y_px) < TRUSTED_RADIUS_SHARE * c.radius_px
    if inside.sum() < 12:
        return c
    along = ball.radius_px / np.sqrt(1.0 + gx * gx + gy * gy)
    moved = replace(
        c,
        x_px=float(np.median((x + along * gx)[inside])),
        y_px=float(np.median((y + along * gy)[inside])),
    )
    radial, _ = _compute_radial_slopes(around, moved)
    local = replace(moved, x_px=moved.x_px - float(x[0, 0]), y_px=moved.y_px - float(y[0, 0]))
    radii, profile = compute_ring_profile(radial, local, 1.7 * c.radius_px)
    far = radii >= max(4.0, 0.4 * c.radius_px)
    if not far.any():
        return moved
    return replace(
        moved, radius_px=min(float(radii[far][int(np.argmax(profile[far]))]), 0.95 * ball.radius_px)
    )


def _fit_circle(around: _Neighbourhood, circle: Circle, ball: BallSlopeProfile) -> Circle:
    """The circle whose ball fits the slopes: two robust Gauss-Newton steps over centre and
    radius.
    """
    c = circle
    for _ in range(2):
        now = _compute_ball_slopes(around, c, ball)
        columns = [
            (_compute_ball_slopes(around, replace(c, x_px=c.x_px + 1.0), ball) - now).ravel(),
            (_compute_ball_slopes(around, replace(c, y_px=c.y_px + 1.0), ball) - now).ravel(),
            (
                _compute_ball_slopes(around, replace(c, radius_px=c.radius_px + 1.0), ball) - now
            ).ravel(),
        ]
        off = (np.stack([around.gx, around.gy]) - now).ravel()
        near = np.hypot(around.x - c.x_px, around.y - c.y_px) < RING_RADII[-1] * c.radius_px
        weight = np.tile(near.ravel(), 2) * np.minimum(1.0, 0.1 / np.maximum(np.abs(off), 1e-6))
        jacobian = np.stack(columns, axis=1)
        normal = jacobian.T @ (jacobian * weight[:, None])
        step = np.linalg.solve(
            normal + 1e-6 * np.trace(normal) * np.eye(3) + 1e-12 * np.eye(3),
            jacobian.T @ (weight * off),
        )
        step = np.clip(step, -3.0, 3.0)
        radius = min(
            max(c.radius_px + float(step[2]), 0.6 * circle.radius_px, 3.0), 0.95 * ball.radius_px
        )
        c = Circle(x_px=c.x_px + float(step[0]), y_px=c.y_px + float(step[1]), radius_px=radius)
    return c


def _compute_ball_slopes(around: _Neighbourhood, circle: Circle, ball: BallSlopeProfile) -> Doubles:
    """Slopes (2, rows, cols) of the ball."""
    dx = around.x - circle.x_px
    dy = around.y - circle.y_px
    r = np.maximum(np.hypot(dx, dy), 1e-6)
    fall = ball.compute_slope(r, circle.radius_px) / r
    return np.stack([-dx * fall, -dy * fall])


def estimate_common_profile(
    model: SlopeModel, presses: Sequence[BallPress], ball_px: float
) -> BallSlopeProfile:
    """The slope profile common to all presses: the median share of the sphere's slope on each
    ring.
    """
    shares: list[Doubles] = []
    for press in presses:
        radial, distance = _compute_radial_slopes(_evaluate_around(model, press), press.circle)
        r = np.minimum(distance, 0.95 * ball_px)
        share = radial * np.sqrt(ball_px**2 - r * r) / r
        ring = np.rint(distance / press.circle.radius_px / RING_RADII[1]).astype(np.intp)
        shares.append(
            np.array(
                [
                    np.median(share[ring == k]) if (ring == k).sum() >= 4 else np.nan
                    for k in range(len(RING_RADII))
                ]
            )
        )
    table = np.array(shares)
    known = np.isfinite(table).any(axis=0)
    common = np.zeros(len(RING_RADII))
    common[known] = np.nanmedian(table[:, known], axis=0)
    return BallSlopeProfile(radius_px=ball_px, sphere_slope_share=np.clip(common, 0.0, 1.0))


_RING_WEIGHT = 0.3  # of a pixel outside the trusted contact: its slope comes from the other presses
# per press
_CONTACT_PIXELS = 1000
_RIM_PIXELS = 600
_UNTOUCHED_PIXELS = 400
_FULL_PRESSES_MAX = 16  # with more presses, each gives fewer pixels
_UNTOUCHED_RADII = 2.5  # contact radii from the centre


def sample_surface(
    press: BallPress, ball: BallSlopeProfile, pixel_mm: float, rng: np.random.Generator
) -> SurfaceSamples:
    """Pixels of the trusted contact with their indentation.

    At the contact's edge, radius a, the indentation of an elastic body is a^2 / 2R (Hertz), in the
    centre twice that.
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
    """Pixels of the contacts, of their rims where the profile is known, and untouched ones, with
    weights (n,).
    """
    parts: list[SlopeSamples] = []
    weights: list[Floats] = []
    share = min(1.0, _FULL_PRESSES_MAX / len(presses))
    sizes = [round(share * n) for n in (_CONTACT_PIXELS, _RIM_PIXELS, _UNTOUCHED_PIXELS)]
    for press in presses:
        zones = [
            rng.choice(z, min(n, len(z)), replace=False)
            for z, n in zip(_find_zones(press), sizes, strict=True)
        ]
        parts.append(_sample(press, ball, np.concatenate(zones))[0])
        weights.append(
            np.repeat((1.0, _RING_WEIGHT, 1.0), [len(z) for z in zones]).astype(np.float32)
        )
    return concatenate_samples(parts), np.concatenate(weights)


def concatenate_samples(parts: Sequence[SlopeSamples]) -> SlopeSamples:
    """The samples of all parts as one."""
    return SlopeSamples(
        change=np.concatenate([s.change for s in parts]),
        u=np.concatenate([s.u for s in parts]),
        v=np.concatenate([s.v for s in parts]),
        slopes=np.concatenate([s.slopes for s in parts]),
    )


def _find_zones(press: BallPress) -> tuple[NDArray[np.intp], ...]:
    """Flat indices of the trusted contact's pixels, of the rim's, and of untouched ones."""
    rows, cols = press.change.shape[:2]
    c = press.circle
    distance = (
        np.hypot((np.arange(cols) - c.x_px)[None, :], (np.arange(rows) - c.y_px)[:, None])
        / c.radius_px
    )
    rim = (distance >= TRUSTED_RADIUS_SHARE) & (distance < RING_RADII[-1])
    return tuple(
        np.flatnonzero(m)
        for m in (distance < TRUSTED_RADIUS_SHARE, rim, distance > _UNTOUCHED_RADII)
    )


def _sample(
    press: BallPress, ball: BallSlopeProfile, where: NDArray[np.intp]
) -> tuple[SlopeSamples, Doubles]:
    """Pixels (flat indices) with the ball's slopes, and their distance from its centre in px."""
    rows, cols = press.change.shape[:2]
    row, col = np.divmod(where, cols)
    dx = col - press.circle.x_px
    dy = row - press.circle.y_px
    r = np.maximum(np.hypot(dx, dy), 1e-6)
    fall = ball.compute_slope(r, press.circle.radius_px) / r
    u, v = slope_model.compute_positions((rows, cols))
    slopes = np.stack([-dx * fall, -dy * fall], axis=1).astype(np.float32)
    return SlopeSamples(change=press.change[row, col], u=u[col], v=v[row], slopes=slopes), r
