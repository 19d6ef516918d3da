"""The sums that least squares over many touches needs, with a robust loss and each touch's own outline growth.

Unknowns are six: a turn about a pivot and a shift, in units of what counts as well known (1 deg, 0.2 mm), so that all
directions compare. Loss: Geman-McClure, s^2 r^2 / (s^2 + r^2), whose scale s is named by kind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.alignment.residuals import Distances, Evidence, compute_outline_distances, compute_surface_distances
from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid

TOLERANCE_MM = 0.2  # a direction whose predicted spread is wider than this says nothing
TOLERANCE_DEG = 1.0
TOLERANCE_UNITS = np.array([math.radians(TOLERANCE_DEG)] * 3 + [TOLERANCE_MM] * 3)  # (rad, mm) of one unit
_IN_ONE_TOUCH = 8.0  # independent readings of each kind: what is a millimetre apart errs alike
_SHARED = 4.0  # this many touches are half as good as any number: a sensor errs alike in all of them
_GROWTH_MM = 0.5  # expected size of an outline's growth from one sensor to the other
_LEAST_NOISE = {"surface": 0.02, "outline": 0.1}  # mm: calibration and pixels; a perfect fit claims no certainty
_ROUNDS = 3  # of finding a touch's growth


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualNoise:
    """Robust standard deviations of the two kinds of distance, mm."""

    surface_mm: float
    outline_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalEquations:
    """The quadratic model around one alignment: cost, gradient and J^T W J in units of tolerance."""

    cost: float
    gradient: Doubles  # (6,)
    information: Doubles  # (6, 6)


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchDistances:
    """The distances of one touch under one alignment."""

    surface: Distances
    outline: Distances


def compute_touch_distances(touches: Sequence[Evidence], target_from_source: Doubles) -> list[TouchDistances]:
    """Distances (mm) of all touches under T_S->T of the descriptions."""
    found: list[TouchDistances] = []
    for touch in touches:
        surface, outline = (
            rigid.apply(target_from_source, points) - touch.instance_shift_mm
            for points in (touch.surface_mm, touch.outline_mm)
        )
        found.append(
            TouchDistances(
                surface=compute_surface_distances(touch, surface), outline=compute_outline_distances(touch, outline)
            )
        )
    return found


def estimate_noise(distances: Sequence[TouchDistances]) -> ResidualNoise:
    """From the median absolute deviation over all touches, the outlines' growth taken off."""
    surface = np.concatenate([s.surface.mm for s in distances])
    outline = np.concatenate([s.outline.mm - _middle(s.outline.mm) for s in distances])
    return ResidualNoise(
        surface_mm=max(_LEAST_NOISE["surface"], 1.4826 * _middle(np.abs(surface))),
        outline_mm=max(_LEAST_NOISE["outline"], 1.4826 * _middle(np.abs(outline))),
    )


def estimate_growth_mm(outline_mm: Doubles, scale_mm: float, noise_mm: float, n_asked: int) -> tuple[float, float]:
    """How much wider (mm) one touch is than its partner, robustly, and 1 / variance of that estimate."""
    each = _IN_ONE_TOUCH / (max(n_asked, 1) * noise_mm**2)
    growth = _middle(outline_mm)
    certainty = _GROWTH_MM**-2
    for _ in range(_ROUNDS):
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
    """Cost, gradient and information over all touches; every touch counts alike."""
    total, gradient, information = 0.0, np.zeros(6), np.zeros((6, 6))
    independent = _IN_ONE_TOUCH / (1.0 + len(touches) / _SHARED)
    for one, touch in zip(distances, touches, strict=True):
        lift = touch.instance_shift_mm - pivot_mm
        for d, sigma, s, grows in (
            (one.surface, noise.surface_mm, scale.surface_mm, False),
            (one.outline, noise.outline_mm, scale.outline_mm, True),
        ):
            if d.n_points == 0:
                continue
            each = independent / (d.n_points * sigma**2)
            growth, certainty = estimate_growth_mm(d.mm, s, sigma, d.n_points) if grows else (0.0, math.inf)
            gap = d.mm - growth
            weight = _weights(gap, s)
            jacobian = np.concatenate([np.cross(d.points_mm + lift, d.jacobian), d.jacobian], axis=1) * TOLERANCE_UNITS
            weighted = jacobian * weight[:, None]
            pull = each * weighted.sum(axis=0)
            gradient += each * (weighted.T @ gap)
            information += each * (weighted.T @ jacobian) - np.outer(pull, pull) / certainty
            # A point that met nothing costs as much as one that is hopelessly off: losing sight is no gain.
            lost = s * s * (d.n_points - len(d.mm))
            total += each * (float((s * s * gap * gap / (s * s + gap * gap)).sum()) + lost)
            total += (growth / _GROWTH_MM) ** 2
    return NormalEquations(cost=total, gradient=gradient, information=information)


def compute_cost(
    touches: Sequence[Evidence], target_from_source: Doubles, noise: ResidualNoise, scale: ResidualNoise
) -> float:
    """What `sums` minimises, for places to be compared under the same `noise` and `scale`."""
    return accumulate_sums(
        compute_touch_distances(touches, target_from_source), touches, np.zeros(3), noise, scale
    ).cost


def _weights(gap_mm: Doubles, scale_mm: float) -> Doubles:
    ratio = scale_mm**2 / (scale_mm**2 + gap_mm**2)
    return ratio * ratio


def _middle(values: Doubles) -> float:
    return float(np.median(values)) if values.size else 0.0
