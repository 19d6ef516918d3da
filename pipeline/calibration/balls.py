"""Calibrating a sensor from presses of one ball: circles, centres and look-up found together.

Inside its contact the gel is the ball: at p from the centre c its slope is -(p - c) / sqrt(R^2 - |p - c|^2), whatever
the load, so only centres have to be known well. They are refined in turns with the look-up: each pixel's predicted
slope g says where the centre must be, c = p + R g / sqrt(1 + g^2), and the median over the contact is kept. Untouched
pixels tie zero change to zero slope. Beyond the trusted part of the contact, which lens blur leaves alone, the slope is
not the ball's, but it is the same to all sides and, in units of the contact's radius, in all presses: the median
profile of all presses becomes a target too, and stops a centre from drifting together with the look-up around it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Image
from pipeline.base.errors import CalibrationError, ShapeError
from pipeline.base.progress import SILENT, Progress
from pipeline.calibration import slope_model
from pipeline.calibration.ball_slopes import RINGS, TRUSTED_SHARE, Ball, Press, common_profile, refined
from pipeline.calibration.contact_circles import Circle, contact_circle
from pipeline.calibration.lookup import BallFit, Calibration, relative_change
from pipeline.calibration.slope_model import Samples, SlopeModel
from pipeline.sensors.spec import SensorSpec

_TURNS = 6
_RING_WEIGHT = 0.3  # of a pixel beyond the trusted contact: its slope is known from the other presses only
_INSIDE, _RIM, _OUTSIDE = 1000, 600, 400  # pixels taken from each press
_UNTOUCHED_FROM = 2.5  # contact radii from the centre
_RIDGE = 3e-4  # of the look-up: found by holding out presses
_OUTLIER = 3.0  # times the median residual: a press that is not one ball on a clean gel
_FOLDS = 5
_DEGREES = ((1, 0), (2, 0), (1, 1), (2, 1), (2, 2), (2, 3), (3, 2), (3, 3))  # of colour and of position
_BEST_WITHIN = 1.02  # a simpler look-up is taken if it is as good as this times the best


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
) -> list[Press]:
    if not images:
        raise CalibrationError("no pictures of presses; give a folder with at least one")
    presses: list[Press] = []
    for index, image in enumerate(images):
        if image.shape != reference.shape or image.ndim != 3:
            raise ShapeError(
                f"press {index} has shape {image.shape}, the reference {reference.shape}; use one camera mode"
            )
        change = relative_change(image, reference, scale, markers=sensor.markers)
        circle = contact_circle(change)
        if circle is not None and circle.radius_px >= 3.0:
            circle = replace(circle, radius_px=min(circle.radius_px, 0.9 * ball_px))
            presses.append(Press(index=index, change=change, circle=circle))
        progress.step(0.3 * (index + 1) / len(images), f"finding the ball in press {index + 1} of {len(images)}")
    if not presses:
        raise CalibrationError("no ball found in any press; check that the reference is the untouched sensor")
    return presses


def _alternate(
    presses: list[Press], ball_px: float, rng: np.random.Generator, progress: Progress
) -> tuple[SlopeModel, list[Press], Ball]:
    """Turns of look-up, circles and the common profile of slopes beyond the trusted contact."""
    degrees = (2, 2) if len(presses) >= 12 else (2, 1) if len(presses) >= 4 else (2, 0)
    ball = Ball(radius_px=ball_px, share=None)
    model = _fitted(presses, ball, rng, degrees)
    for turn in range(_TURNS):
        presses = [replace(p, circle=refined(model, p, ball)) for p in presses]
        ball = common_profile(model, presses, ball_px)
        model = _fitted(presses, ball, rng, degrees)
        progress.step(0.3 + 0.5 * (turn + 1) / _TURNS, f"refining circles, turn {turn + 1} of {_TURNS}")
    return model, presses, ball


def _fitted(presses: Sequence[Press], ball: Ball, rng: np.random.Generator, degrees: tuple[int, int]) -> SlopeModel:
    parts = [_samples(p, ball, rng) for p in presses]
    samples = Samples(
        change=np.concatenate([s.change for s, _ in parts]), u=np.concatenate([s.u for s, _ in parts]),
        v=np.concatenate([s.v for s, _ in parts]), slopes=np.concatenate([s.slopes for s, _ in parts]),
    )  # fmt: skip
    weights = np.concatenate([w for _, w in parts])
    return slope_model.fit(samples, weights, colour_degree=degrees[0], position_degree=degrees[1], ridge=_RIDGE)


def _samples(press: Press, ball: Ball, rng: np.random.Generator | None) -> tuple[Samples, Floats]:
    """Pixels of one press with slopes and weights; all of the trusted contact and nothing else if `rng` is None."""
    rows, cols = press.change.shape[:2]
    c = press.circle
    x, y = np.arange(cols) - c.x_px, np.arange(rows) - c.y_px
    distance = np.hypot(x[None, :], y[:, None]) / c.radius_px
    zones = [np.flatnonzero(distance < TRUSTED_SHARE)]
    if rng is not None:
        rim = (distance >= TRUSTED_SHARE) & (distance < RINGS[-1]) & (ball.share is not None)
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


def _residual(model: SlopeModel, press: Press, ball: Ball) -> float:
    samples, _ = _samples(press, ball, None)
    if len(samples.u) == 0:
        return math.inf
    return float(np.sqrt(np.mean((slope_model.predict(model, samples) - samples.slopes) ** 2)))


def _chosen_degrees(presses: Sequence[Press], ball: Ball, rng: np.random.Generator) -> tuple[int, int]:
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
        errors[k] = float(np.mean(held))
    enough = np.flatnonzero(errors <= _BEST_WITHIN * errors.min())
    return _DEGREES[min(enough, key=lambda k: slope_model.n_terms(*_DEGREES[int(k)]))]


def _report(n: int, presses: Sequence[Press], model: SlopeModel, ball: Ball) -> tuple[BallFit, ...]:
    used = {p.index: p for p in presses}
    fits: list[BallFit] = []
    for index in range(n):
        p = used.get(index)
        c = p.circle if p is not None else Circle(x_px=math.nan, y_px=math.nan, radius_px=math.nan)
        residual = math.nan if p is None else _residual(model, p, ball)
        fits.append(
            BallFit(index=index, x_px=c.x_px, y_px=c.y_px, radius_px=c.radius_px, residual=residual, used=p is not None)
        )
    return tuple(fits)
