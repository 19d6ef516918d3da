"""Normal equations of the alignment over many touches, with a robust loss and a growth of each
touch's outline.

Unknowns are six: a rotation about a pivot and a translation, in units of the tolerance (1 deg, 0.2
mm), so that all directions compare. Loss: Geman-McClure, s^2 r^2 / (s^2 + r^2), with a scale s for
each kind.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.translation.alignment.residuals import (
    Distances,
    Evidence,
    compute_outline_distances,
    compute_surface_distances,
)

TOLERANCE_MM = 0.2  # predicted std above which a direction counts as undetermined
TOLERANCE_DEG = 1.0
# (rad, mm) of one unit
TOLERANCE_UNITS = np.array([math.radians(TOLERANCE_DEG)] * 3 + [TOLERANCE_MM] * 3)
_INDEPENDENT_IN_TOUCH = (
    # independent measurements of each kind in a touch: errors within a millimetre are correlated
    8.0
)
_SHARED_ERROR_TOUCHES = (
    # this many touches have half the weight of any number: a sensor's error is alike in all of them
    4.0
)
_GROWTH_MM = 0.5  # expected growth of an outline from one sensor to the other
# mm: calibration and pixels; avoids a zero covariance
_MIN_NOISE = {"surface": 0.02, "outline": 0.1}
_ITERATIONS = 3  # iterations of estimating a touch's growth


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualNoise:
    """Robust standard deviations (mm) of the two kinds of distance."""

    surface_mm: float
    outline_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalEquations:
    """The quadratic model around one alignment: cost, gradient and J^T W J in units of
    tolerance.
    """

    cost: float
    gradient: Doubles  # (6,)
    information: Doubles  # (6, 6)


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchDistances:
    """The distances of one touch under one alignment."""

    surface: Distances
    outline: Distances


def compute_touch_distances(
    touches: Sequence[Evidence], target_from_source: Doubles
) -> list[TouchDistances]:
    """Compute the distances (mm) of each touch under the described T_S->T."""
    found: list[TouchDistances] = []
    for touch in touches:
        surface, outline = (
            rigid.apply(target_from_source, points) - touch.instance_shift_mm
            for points in (touch.surface_mm, touch.outline_mm)
        )
        found.append(
            TouchDistances(
                surface=compute_surface_distances(touch, surface),
                outline=compute_outline_distances(touch, outline),
            )
        )
    return found


def estimate_noise(distances: Sequence[TouchDistances]) -> ResidualNoise:
    """Estimate noise from the median absolute deviation over all touches, less the outlines'
    growth.
    """
    surface = np.concatenate([s.surface.mm for s in distances])
    outline = np.concatenate([s.outline.mm - _median(s.outline.mm) for s in distances])
    return ResidualNoise(
        surface_mm=max(_MIN_NOISE["surface"], 1.4826 * _median(np.abs(surface))),
        outline_mm=max(_MIN_NOISE["outline"], 1.4826 * _median(np.abs(outline))),
    )


def estimate_growth_mm(
    outline_mm: Doubles, scale_mm: float, noise_mm: float, n_asked: int
) -> tuple[float, float]:
    """Return how much wider (mm) a touch's outline is than its partner's, and 1 / variance of
    that.
    """
    each = _INDEPENDENT_IN_TOUCH / (max(n_asked, 1) * noise_mm**2)
    growth = _median(outline_mm)
    certainty = _GROWTH_MM**-2
    for _ in range(_ITERATIONS):
        weight = _weights(outline_mm - growth, scale_mm)
        certainty = each * float(weight.sum()) + _GROWTH_MM**-2
        growth = each * float(weight @ outline_mm) / certainty
    return growth, certainty


def accumulate_sums(
    distances: Sequence[TouchDistances],
    touches: Sequence[Evidence],
    pivot_mm: Doubles,
    noise: ResidualNoise,
    scale: ResidualNoise,
) -> NormalEquations:
    """Accumulate cost, gradient and information over all touches with equal weight."""
    total = 0.0
    gradient = np.zeros(6)
    information = np.zeros((6, 6))
    independent = _INDEPENDENT_IN_TOUCH / (1.0 + len(touches) / _SHARED_ERROR_TOUCHES)
    for one, touch in zip(distances, touches, strict=True):
        lift = touch.instance_shift_mm - pivot_mm
        for d, sigma, s, grows in (
            (one.surface, noise.surface_mm, scale.surface_mm, False),
            (one.outline, noise.outline_mm, scale.outline_mm, True),
        ):
            if d.n_points == 0:
                continue
            each = independent / (d.n_points * sigma**2)
            growth, certainty = (
                estimate_growth_mm(d.mm, s, sigma, d.n_points) if grows else (0.0, math.inf)
            )
            gap = d.mm - growth
            weight = _weights(gap, s)
            jacobian = (
                np.concatenate([np.cross(d.points_mm + lift, d.jacobian), d.jacobian], axis=1)
                * TOLERANCE_UNITS
            )
            weighted = jacobian * weight[:, None]
            pull = each * weighted.sum(axis=0)
            gradient += each * (weighted.T @ gap)
            information += each * (weighted.T @ jacobian) - np.outer(pull, pull) / certainty
            # A point with nothing to compare costs as much as an outlier: leaving the view is no
            # gain.
            lost = s * s * (d.n_points - len(d.mm))
            total += each * (float((s * s * gap * gap / (s * s + gap * gap)).sum()) + lost)
            total += (growth / _GROWTH_MM) ** 2
    return NormalEquations(cost=total, gradient=gradient, information=information)


def compute_cost(
    touches: Sequence[Evidence],
    target_from_source: Doubles,
    noise: ResidualNoise,
    scale: ResidualNoise,
) -> float:
    """Return the cost that `accumulate_sums` minimises, to compare alignments under one `noise`
    and `scale`.
    """
    return accumulate_sums(
        compute_touch_distances(touches, target_from_source), touches, np.zeros(3), noise, scale
    ).cost


def _weights(gap_mm: Doubles, scale_mm: float) -> Doubles:
    ratio = scale_mm**2 / (scale_mm**2 + gap_mm**2)
    return ratio * ratio


def _median(values: Doubles) -> float:
    return float(np.median(values)) if values.size else 0.0
