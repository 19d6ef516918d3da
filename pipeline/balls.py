"""Calibrating a sensor from presses of one ball: circles, centres and look-up found together.

Inside its contact the gel is the ball: at p from the centre c its slope is -(p - c) / sqrt(R^2 - |p - c|^2), whatever the
load, so only centres have to be known well. They are refined in turns with the look-up: each pixel's predicted slope g
says where the centre must be, c = p + R g / sqrt(1 + g^2), and the median over the contact is kept. Untouched pixels tie
zero change to zero slope, which leaves the turns no freedom to drift. The contact's radius is where the radial slope is
largest; a little less than that is trusted, as the lens blurs the rim.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pipeline import slope_model
from pipeline.arrays import Doubles, Floats, Image
from pipeline.calibration import BallFit, Calibration, relative_change
from pipeline.contact_circles import Circle, contact_circle, ring_profile
from pipeline.errors import CalibrationError, ShapeError
from pipeline.progress import SILENT, Progress
from pipeline.sensors.spec import SensorSpec
from pipeline.slope_model import Samples, SlopeModel

TRUSTED_SHARE = 0.85  # of the contact's radius: inside it the blurred rim is not felt
_TURNS = 6
_RINGS = np.arange(0.0, 2.001, 0.05)  # r / contact radius at which the slope's profile is tabulated
_RING_WEIGHT = 0.3  # of a pixel beyond the trusted contact: its slope is known from the other presses only
_INSIDE, _RIM, _OUTSIDE = 1000, 600, 400  # pixels taken from each press
_UNTOUCHED_FROM = 2.5  # contact radii from the centre
_RIDGE = 3e-4  # of the look-up: found by holding out presses
_OUTLIER = 3.0  # times the median residual: a press that is not one ball on a clean gel
_FOLDS = 5
_DEGREES = ((1, 0), (2, 0), (1, 1), (2, 1), (2, 2), (2, 3), (3, 2), (3, 3))  # of colour and of position
_BEST_WITHIN = 1.02  # a simpler look-up is taken if it is as good as this times the best


@dataclass(frozen=True, slots=True, kw_only=True)
class _Press:
    index: int
    change: Floats  # (rows, cols, 3)
    circle: Circle


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ball:
    """The slope that a press leaves at distance r from its centre: the sphere's, times what the rim and the gel make of it."""

    radius_px: float
    share: Doubles | None  # of the sphere's slope, at `_RINGS`; None = not known beyond the trusted contact

    def slope(self, distance_px: Doubles, contact_px: float) -> Doubles:
        """Slope toward the centre, mm/mm."""
        r = np.minimum(distance_px, 0.95 * self.radius_px)
        sphere = r / np.sqrt(self.radius_px**2 - r * r)
        t = distance_px / contact_px
        if self.share is None:
            return np.where(t < TRUSTED_SHARE, sphere, 0.0)
        return sphere * np.where(t < TRUSTED_SHARE, 1.0, np.interp(t, _RINGS, self.share, right=0.0))


def calibrate_balls(
    images: Sequence[Image],
    reference: Image,
    sensor: SensorSpec,
    diameter_mm: float,
    *,
    pixel_mm: float | None = None,
    progress: Progress = SILENT,
    seed: int = 0,
) -> Calibration:
    """The look-up of `sensor` from pictures (rows, cols, 3) of presses of one ball; `presses` tells of each.

    `pixel_mm` None takes the sensor's own. Raises ShapeError for pictures of another size, CalibrationError when no
    picture shows a ball or the size cannot be right.
    """
    scale = sensor.pixel_mm if pixel_mm is None else pixel_mm
    ball_px = 0.5 * diameter_mm / scale if scale > 0 else math.nan
    if not (math.isfinite(ball_px) and ball_px > 3.0):
        raise CalibrationError(f"a ball of {diameter_mm!r} mm cannot be seen at {scale!r} mm/px; check both")
    presses = _found(images, reference, sensor, scale, ball_px, progress)
    rng = np.random.default_rng(seed)
    model, presses, ball = _alternate(presses, ball_px, rng, progress)
    errors = np.array([_residual(model, p, ball) for p in presses])
    good = errors <= _OUTLIER * float(np.median(errors))
    if good.sum() >= 1 and not good.all():
        model, presses, ball = _alternate([p for p, g in zip(presses, good, strict=True) if g], ball_px, rng, progress)
    degrees = _chosen_degrees(presses, ball, np.random.default_rng(seed))
    model = _fitted(presses, ball, np.random.default_rng(seed), degrees)
    progress.step(1.0, "look-up is ready")
    return Calibration(
        sensor=sensor.name, rows=reference.shape[0], cols=reference.shape[1], pixel_mm=scale, model=model,
        residual=float(np.sqrt(np.mean([_residual(model, p, ball) ** 2 for p in presses]))),
        origin=f"{len(presses)} of {len(images)} presses of a ball of {diameter_mm:g} mm",
        presses=_report(len(images), presses, model, ball),
    )  # fmt: skip


def _found(
    images: Sequence[Image], reference: Image, sensor: SensorSpec, scale: float, ball_px: float, progress: Progress
) -> list[_Press]:
    if not images:
        raise CalibrationError("no pictures of presses; give a folder with at least one")
    presses: list[_Press] = []
    for index, image in enumerate(images):
        if image.shape != reference.shape or image.ndim != 3:
            raise ShapeError(
                f"press {index} has shape {image.shape}, the reference {reference.shape}; use one camera mode"
            )
        change = relative_change(image, reference, scale, markers=sensor.markers)
        circle = contact_circle(change)
        if circle is not None and circle.radius_px >= 3.0:
            circle = replace(circle, radius_px=min(circle.radius_px, 0.9 * ball_px))
            presses.append(_Press(index=index, change=change, circle=circle))
        progress.step(0.3 * (index + 1) / len(images), f"finding the ball in press {index + 1} of {len(images)}")
    if not presses:
        raise CalibrationError("no ball found in any press; check that the reference is the untouched sensor")
    return presses


def _alternate(
    presses: list[_Press], ball_px: float, rng: np.random.Generator, progress: Progress
) -> tuple[SlopeModel, list[_Press], _Ball]:
    """Turns of look-up, circles and the common profile of slopes beyond the trusted contact."""
    degrees = (2, 2) if len(presses) >= 12 else (2, 1) if len(presses) >= 4 else (2, 0)
    ball = _Ball(radius_px=ball_px, share=None)
    model = _fitted(presses, ball, rng, degrees)
    for turn in range(_TURNS):
        presses = [replace(p, circle=_refined(model, p, ball)) for p in presses]
        ball = _common_profile(model, presses, ball_px)
        model = _fitted(presses, ball, rng, degrees)
        progress.step(0.3 + 0.5 * (turn + 1) / _TURNS, f"refining circles, turn {turn + 1} of {_TURNS}")
    return model, presses, ball


def _fitted(presses: Sequence[_Press], ball: _Ball, rng: np.random.Generator, degrees: tuple[int, int]) -> SlopeModel:
    parts = [_samples(p, ball, rng) for p in presses]
    samples = Samples(
        change=np.concatenate([s.change for s, _ in parts]), u=np.concatenate([s.u for s, _ in parts]),
        v=np.concatenate([s.v for s, _ in parts]), slopes=np.concatenate([s.slopes for s, _ in parts]),
    )  # fmt: skip
    weights = np.concatenate([w for _, w in parts])
    return slope_model.fit(samples, weights, colour_degree=degrees[0], position_degree=degrees[1], ridge=_RIDGE)


def _samples(press: _Press, ball: _Ball, rng: np.random.Generator | None) -> tuple[Samples, Floats]:
    """Pixels of one press with their slopes and weights; all of the trusted contact and nothing else if `rng` is None."""
    rows, cols = press.change.shape[:2]
    c = press.circle
    x, y = np.arange(cols) - c.x_px, np.arange(rows) - c.y_px
    distance = np.hypot(x[None, :], y[:, None]) / c.radius_px
    zones = [np.flatnonzero(distance < TRUSTED_SHARE)]
    if rng is not None:
        rim = (distance >= TRUSTED_SHARE) & (distance < _RINGS[-1]) & (ball.share is not None)
        zones += [np.flatnonzero(rim), np.flatnonzero(distance > _UNTOUCHED_FROM)]
        sizes = (_INSIDE, _RIM, _OUTSIDE)
        zones = [rng.choice(z, min(n, len(z)), replace=False) for z, n in zip(zones, sizes, strict=True)]
    where = np.concatenate(zones)
    weight = np.repeat((1.0, _RING_WEIGHT, 1.0)[: len(zones)], [len(z) for z in zones]).astype(np.float32)
    row, col = np.divmod(where, cols)
    dx, dy = x[col], y[row]
    r = np.maximum(np.hypot(dx, dy), 1e-6)
    fall = ball.slope(r, c.radius_px) / r
    u, v = slope_model.position((rows, cols))
    slopes = np.stack([-dx * fall, -dy * fall], axis=1).astype(np.float32)
    return Samples(change=press.change[row, col], u=u[col], v=v[row], slopes=slopes), weight


@dataclass(frozen=True, slots=True, kw_only=True)
class _Around:
    """What the look-up sees around one press."""

    x: Doubles  # (1, cols) of the image
    y: Doubles  # (rows, 1)
    gx: Floats  # (rows, cols)
    gy: Floats


def _around(model: SlopeModel, press: _Press) -> _Around:
    c = press.circle
    rows, cols = press.change.shape[:2]
    reach = _RINGS[-1] * c.radius_px + 4.0
    r0, r1 = (min(max(0, round(c.y_px + d * reach)), rows) for d in (-1, 1))
    c0, c1 = (min(max(0, round(c.x_px + d * reach)), cols) for d in (-1, 1))
    u, v = slope_model.position((rows, cols))
    part = np.ascontiguousarray(press.change[r0:r1, c0:c1])
    gx, gy = slope_model.evaluate(model, part, u[c0:c1], v[r0:r1], np.ones(part.shape[:2], np.bool_))
    return _Around(
        x=np.arange(c0, c1, dtype=np.float64)[None, :], y=np.arange(r0, r1, dtype=np.float64)[:, None], gx=gx, gy=gy
    )


def _radial(around: _Around, circle: Circle) -> tuple[Floats, Doubles]:
    """(slope toward the centre, distance from it) of every pixel around a press."""
    dx, dy = around.x - circle.x_px, around.y - circle.y_px
    distance = np.maximum(np.hypot(dx, dy), 1e-6)
    return (-(around.gx * dx + around.gy * dy) / distance).astype(np.float32), distance


def _refined(model: SlopeModel, press: _Press, ball: _Ball) -> Circle:
    """The circle that the look-up's own slopes speak for."""
    c, around = press.circle, _around(model, press)
    x, y, gx, gy = around.x, around.y, around.gx, around.gy
    if ball.share is not None:
        return _aligned(around, c, ball)
    inside = np.hypot(x - c.x_px, y - c.y_px) < TRUSTED_SHARE * c.radius_px
    if inside.sum() < 12:
        return c
    along = ball.radius_px / np.sqrt(1.0 + gx * gx + gy * gy)
    moved = replace(c, x_px=float(np.median((x + along * gx)[inside])), y_px=float(np.median((y + along * gy)[inside])))
    radial, _ = _radial(around, moved)
    local = replace(moved, x_px=moved.x_px - float(x[0, 0]), y_px=moved.y_px - float(y[0, 0]))
    radii, profile = ring_profile(radial, local, 1.7 * c.radius_px)
    far = radii >= max(4.0, 0.4 * c.radius_px)
    if not far.any():
        return moved
    return replace(moved, radius_px=min(float(radii[far][int(np.argmax(profile[far]))]), 0.95 * ball.radius_px))


def _aligned(around: _Around, circle: Circle, ball: _Ball) -> Circle:
    """The circle whose ball leaves the slopes seen: two robust Gauss-Newton steps over centre and radius."""
    c = circle
    for _ in range(2):
        now = _field(around, c, ball)
        columns = [
            (_field(around, replace(c, x_px=c.x_px + 1.0), ball) - now).ravel(),
            (_field(around, replace(c, y_px=c.y_px + 1.0), ball) - now).ravel(),
            (_field(around, replace(c, radius_px=c.radius_px + 1.0), ball) - now).ravel(),
        ]
        off = (np.stack([around.gx, around.gy]) - now).ravel()
        near = np.hypot(around.x - c.x_px, around.y - c.y_px) < _RINGS[-1] * c.radius_px
        weight = np.tile(near.ravel(), 2) * np.minimum(1.0, 0.1 / np.maximum(np.abs(off), 1e-6))
        jacobian = np.stack(columns, axis=1)
        normal = jacobian.T @ (jacobian * weight[:, None])
        step = np.linalg.solve(
            normal + 1e-6 * np.trace(normal) * np.eye(3) + 1e-12 * np.eye(3), jacobian.T @ (weight * off)
        )
        step = np.clip(step, -3.0, 3.0)
        radius = min(max(c.radius_px + float(step[2]), 0.6 * circle.radius_px, 3.0), 0.95 * ball.radius_px)
        c = Circle(x_px=c.x_px + float(step[0]), y_px=c.y_px + float(step[1]), radius_px=radius)
    return c


def _field(around: _Around, circle: Circle, ball: _Ball) -> Doubles:
    """Slopes (2, rows, cols) that the ball leaves."""
    dx, dy = around.x - circle.x_px, around.y - circle.y_px
    r = np.maximum(np.hypot(dx, dy), 1e-6)
    fall = ball.slope(r, circle.radius_px) / r
    return np.stack([-dx * fall, -dy * fall])


def _common_profile(model: SlopeModel, presses: Sequence[_Press], ball_px: float) -> _Ball:
    """The share of the sphere's slope that is seen at each ring, the median of all presses: the same to all sides."""
    shares: list[Doubles] = []
    for press in presses:
        radial, distance = _radial(_around(model, press), press.circle)
        r = np.minimum(distance, 0.95 * ball_px)
        share = radial * np.sqrt(ball_px**2 - r * r) / r
        ring = np.rint(distance / press.circle.radius_px / _RINGS[1]).astype(np.intp)
        shares.append(
            np.array([np.median(share[ring == k]) if (ring == k).sum() >= 4 else np.nan for k in range(len(_RINGS))])
        )
    table = np.array(shares)
    known = np.isfinite(table).any(axis=0)
    common = np.zeros(len(_RINGS))
    common[known] = np.nanmedian(table[:, known], axis=0)
    return _Ball(radius_px=ball_px, share=np.clip(common, 0.0, 1.0))


def _residual(model: SlopeModel, press: _Press, ball: _Ball) -> float:
    samples, _ = _samples(press, ball, None)
    if len(samples.u) == 0:
        return math.inf
    return float(np.sqrt(np.mean((slope_model.predict(model, samples) - samples.slopes) ** 2)))


def _chosen_degrees(presses: Sequence[_Press], ball: _Ball, rng: np.random.Generator) -> tuple[int, int]:
    """The simplest look-up among the best for presses that it has not seen."""
    n = len(presses)
    if n < _FOLDS:
        return (2, 0) if n < 4 else (2, 1)
    order = rng.permutation(n)
    edges = np.linspace(0, n, _FOLDS + 1).astype(int)
    errors: Doubles = np.zeros(len(_DEGREES))
    for k, degrees in enumerate(_DEGREES):
        held: list[float] = []
        for a, b in pairwise(edges):
            out = {int(i) for i in order[a:b]}
            model = _fitted([p for i, p in enumerate(presses) if i not in out], ball, np.random.default_rng(0), degrees)
            held += [_residual(model, presses[i], ball) for i in sorted(out)]
        errors[k] = float(np.median(held))
    enough = np.flatnonzero(errors <= _BEST_WITHIN * errors.min())
    return _DEGREES[min(enough, key=lambda k: slope_model.n_terms(*_DEGREES[int(k)]))]


def _report(n: int, presses: Sequence[_Press], model: SlopeModel, ball: _Ball) -> tuple[BallFit, ...]:
    used = {p.index: p for p in presses}
    fits: list[BallFit] = []
    for index in range(n):
        p = used.get(index)
        c = p.circle if p is not None else Circle(x_px=math.nan, y_px=math.nan, radius_px=math.nan)
        fits.append(BallFit(index=index, x_px=c.x_px, y_px=c.y_px, radius_px=c.radius_px,
                            residual=math.nan if p is None else _residual(model, p, ball), used=p is not None))  # fmt: skip
    return tuple(fits)
