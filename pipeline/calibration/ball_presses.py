"""Presses of a ball: the slopes around one, the circle that fits measured slopes, and pixels with
known slopes.

The pixels are what the shading field is fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from pipeline.calibration import slope_model
from pipeline.calibration.contact_circles import Circle
from pipeline.calibration.shading_field import SurfaceSamples, compute_shading_terms
from pipeline.calibration.slope_model import SlopeModel, SlopeSamples
from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.frozen import frozen

TRUSTED_RADIUS_SHARE = 0.85  # of the contact's radius: inside it the rim's blur has no effect
# radii over the contact radius at which the slope profile is tabulated
RING_RADII = np.arange(0.0, 2.001, 0.05)
_CONTACT_PIXELS = 1000  # of a press, that the field is fitted to
_SLOPE_HUBER = 0.1  # mm/mm: larger residuals count less
_STEP_MAX_PX = 3.0


def _compute_hertz_share() -> Doubles:
    """Slope of an elastic half-space under a ball, over the ball's, at `RING_RADII` (Hertz)."""
    t = np.maximum(RING_RADII, 1.0)
    return freeze(2.0 / np.pi * (np.arcsin(1.0 / t) - np.sqrt(t**2 - 1.0) / t**2))


@frozen
class BallPress:
    """One image of a press."""

    index: int
    change: Floats  # (rows, cols, 3)
    circle: Circle


@frozen
class BallSlopeProfile:
    """Radial slope profile of a press: the sphere's slope times a share that accounts for the
    rim.
    """

    radius_px: float
    # at `RING_RADII`
    sphere_slope_share: Doubles = field(default_factory=_compute_hertz_share)

    def compute_slopes(self, dx: Doubles, dy: Doubles, contact_px: float) -> Doubles:
        """Slopes (2, ...), mm/mm, at offsets from the centre in px."""
        distance = np.maximum(np.hypot(dx, dy), 1e-6)
        share = np.interp(distance / contact_px, RING_RADII, self.sphere_slope_share, right=0.0)
        share = np.where(distance < TRUSTED_RADIUS_SHARE * contact_px, 1.0, share)
        r = np.minimum(distance, 0.95 * self.radius_px)
        fall = share * r / np.sqrt(self.radius_px**2 - r * r) / distance
        return np.stack([-dx * fall, -dy * fall])


def _evaluate_around(model: SlopeModel, press: BallPress) -> tuple[Doubles, Doubles, Floats]:
    """Columns and rows (rows, cols) of the image around a press, and the slopes (2, rows, cols)
    there by a calibration table.
    """
    c = press.circle
    rows, cols = press.change.shape[:2]
    reach = RING_RADII[-1] * c.radius_px + 4.0
    r0, r1 = (min(max(0, round(c.y_px + d * reach)), rows) for d in (-1, 1))
    c0, c1 = (min(max(0, round(c.x_px + d * reach)), cols) for d in (-1, 1))
    u, v = slope_model.compute_positions((rows, cols))
    part = np.ascontiguousarray(press.change[r0:r1, c0:c1])
    every = np.ones(part.shape[:2], np.bool_)
    y, x = np.mgrid[r0:r1, c0:c1].astype(np.float64)
    return x, y, np.stack(slope_model.evaluate(model, part, u[c0:c1], v[r0:r1], every))


def refine_circle(model: SlopeModel, press: BallPress, ball: BallSlopeProfile) -> Circle:
    """The circle whose ball fits the slopes of a calibration table: two robust Gauss-Newton steps
    over centre and radius.
    """
    x, y, slopes = _evaluate_around(model, press)

    def compute_slopes(p: Doubles) -> Doubles:
        return ball.compute_slopes(x - p[0], y - p[1], p[2]).ravel()

    first = press.circle.radius_px
    place = np.array([press.circle.x_px, press.circle.y_px, first])
    for _ in range(2):
        now = compute_slopes(place)
        jacobian = np.stack([compute_slopes(place + one) - now for one in np.eye(3)], axis=1)
        off = slopes.ravel() - now
        near = np.hypot(x - place[0], y - place[1]) < RING_RADII[-1] * place[2]
        weight = np.tile(near.ravel(), 2) * np.minimum(
            1.0, _SLOPE_HUBER / np.maximum(np.abs(off), 1e-6)
        )
        normal = jacobian.T @ (jacobian * weight[:, None])
        normal += (1e-6 * np.trace(normal) + 1e-12) * np.eye(3)
        step = np.linalg.solve(normal, jacobian.T @ (weight * off))
        place = place + np.clip(step, -_STEP_MAX_PX, _STEP_MAX_PX)
        place[2] = min(max(place[2], 0.6 * first, 3.0), 0.95 * ball.radius_px)
    return Circle(x_px=float(place[0]), y_px=float(place[1]), radius_px=float(place[2]))


def estimate_common_profile(
    model: SlopeModel, presses: Sequence[BallPress], ball_px: float
) -> BallSlopeProfile:
    """The slope profile common to all presses: the median share of the sphere's slope on each
    ring.
    """
    shares: list[Doubles] = []
    for press in presses:
        x, y, slopes = _evaluate_around(model, press)
        dx = x - press.circle.x_px
        dy = y - press.circle.y_px
        distance = np.maximum(np.hypot(dx, dy), 1e-6)
        radial = -(slopes[0] * dx + slopes[1] * dy) / distance
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


def sample_surface(
    press: BallPress, ball: BallSlopeProfile, pixel_mm: float, rng: np.random.Generator
) -> SurfaceSamples:
    """Pixels of the trusted contact with their indentation.

    At the contact's edge, radius a, the indentation of an elastic body is a^2 / 2R (Hertz), in the
    centre twice that.
    """
    samples, distance_px = _sample(press, ball, rng)
    deep_px = (press.circle.radius_px**2 - 0.5 * distance_px**2) / ball.radius_px
    parts = compute_shading_terms(samples.slopes.astype(np.float64), deep_px * pixel_mm)
    return SurfaceSamples(u=samples.u, v=samples.v, shading_terms=parts, change=samples.change)


def sample_contact(
    press: BallPress, ball: BallSlopeProfile, rng: np.random.Generator | None = None
) -> SlopeSamples:
    """Pixels of the trusted contact: some at random, without `rng` all."""
    return _sample(press, ball, rng)[0]


def _sample(
    press: BallPress, ball: BallSlopeProfile, rng: np.random.Generator | None
) -> tuple[SlopeSamples, Doubles]:
    """Pixels with the ball's slopes, and their distance from its centre in px."""
    shape = press.change.shape[:2]
    c = press.circle
    y_px, x_px = np.mgrid[: shape[0], : shape[1]]
    inside = np.hypot(x_px - c.x_px, y_px - c.y_px) < TRUSTED_RADIUS_SHARE * c.radius_px
    row, col = np.nonzero(inside)
    if rng is not None:
        some = rng.choice(len(row), min(_CONTACT_PIXELS, len(row)), replace=False)
        row = row[some]
        col = col[some]
    dx = np.asarray(col - c.x_px, np.float64)
    dy = np.asarray(row - c.y_px, np.float64)
    u, v = slope_model.compute_positions(shape)
    slopes = ball.compute_slopes(dx, dy, c.radius_px).T.astype(np.float32)
    samples = SlopeSamples(change=press.change[row, col], u=u[col], v=v[row], slopes=slopes)
    return samples, np.hypot(dx, dy)
