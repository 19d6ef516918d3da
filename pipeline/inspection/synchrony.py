"""Whether two streams felt the same touches at the same moments, or a list of pairs has lost its order.

Nothing is known of how the sensors stand to each other, and little of how a touch looks in either. Of every moment
counts how strongly it is felt, and where. Strengths are compared with those of the other stream, distances between the
places of two moments with those of the other (Mantel 1967), whatever turn, mirror image or scale lies between. How
often moments in a random order agree as well is counted. What hardly differs from moment to moment tells no order: a
press that is repeated says nothing, and what rises and falls slowly agrees with itself a few frames later.

Of 29 true pairs of streams (a sample; poses of six training objects, presses and slides, on units that vary) none
is doubted: one in 250 random orders agrees as well at most. Of real ones of a GelSlim and a bubble none is doubted from
20 on, 3 % are with 12. In a random order nineteen of twenty are, and the shift of half of those that are three frames
late is told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Mask
from pipeline.base.errors import TouchError
from pipeline.base.stage_warnings import StageWarning
from pipeline.values.frames import Stream, TactileFrame

_FEWEST, _MOST = 12, 96  # moments: fewer tell nothing, more only take time
_ORDERS, _BY_CHANCE = 999, 0.05  # random ones, and the share of them that may agree as well
_STRENGTHS, _PLACES = 0.15, 0.03  # standard deviations that tell: of the mean strength; of a picture's longer side
_BLOCKS_ALONG = 48  # of a picture's longer side
_TOUCHED = 0.5  # of the way from the weakest to the strongest logarithm, where these lie far apart
_FAR_APART = 0.5  # standard deviation of the logarithm: some moments are no touches
_LAGS, _MOST_LAGS = 1 / 3, 12  # of the moments; either way
_SURELY = 0.05  # share of random orders, over all lags that are tried
_CLEARER = 1.3  # than at any other lag but its neighbours
_ALIKE = 1e-12  # correlations that differ by rounding


class ContactSignature(NamedTuple):
    """What is felt at one moment."""

    strength: float  # in the reading's own unit; 0 = nothing
    x: float  # of a picture's longer side; NaN = nowhere
    y: float


NO_CONTACT_SIGNATURE = ContactSignature(0.0, np.nan, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class SynchronyResult:
    """How the moments of two streams go together."""

    n_moments: int
    p_value: float  # share of random orders that agree as well, in what agrees best
    z_score: float  # by how many standard deviations of theirs it agrees better
    lag_frames: int = 0  # frames by which the second comes later; 0 where no shift makes them agree

    @property
    def warning(self) -> StageWarning | None:
        """What speaks against the order; None where nothing does."""
        if self.p_value <= _BY_CHANCE:
            return None
        way = "late" if self.lag_frames > 0 else "early"
        late = f"; they agree when the second is taken to come {abs(self.lag_frames)} frames {way}"
        return StageWarning(
            f"are these pairs of one touch each? How strongly and where the {self.n_moments} moments are felt agrees between "
            f"the two as by chance (as well in {self.p_value:.0%} of random orders){late if self.lag_frames else ''}"
        )


def compute_signature(change: Floats) -> ContactSignature:
    """What a change (rows, cols), larger where more is felt, says of its moment."""
    import cv2

    rows, cols = change.shape
    by = _BLOCKS_ALONG / max(rows, cols)
    size = (max(1, round(by * cols)), max(1, round(by * rows)))
    blocks = np.abs(np.asarray(cv2.resize(np.nan_to_num(change), size, interpolation=cv2.INTER_AREA), np.float64))
    peak = np.maximum(blocks - 0.5 * float(blocks.max()), 0.0)
    total = float(peak.sum())
    if total <= 0.0:
        return NO_CONTACT_SIGNATURE
    y, x = (np.arange(n) / max(size) for n in blocks.shape)
    strength = math.sqrt(float((blocks**2).mean()))
    return ContactSignature(strength, float(peak.sum(axis=0) @ x) / total, float(peak.sum(axis=1) @ y) / total)


def compute_frame_signature(frame: TactileFrame) -> ContactSignature:
    """`felt` of a frame; nothing where it brings no untouched reading of its shape."""
    if frame.reference is None or frame.reference.shape != frame.image.shape:
        return NO_CONTACT_SIGNATURE
    change = np.nan_to_num(frame.image.astype(np.float32) - frame.reference.astype(np.float32))
    return compute_signature(change if frame.is_depth else np.abs(change).sum(axis=2))


def compare_streams(one: Stream, other: Stream) -> SynchronyResult | None:
    """`together` of two streams' frames with the same numbers, of some spread evenly; None as there."""
    n = min(one.n_frames, other.n_frames)
    first = [k * n // _MOST for k in range(_MOST)] if n > _MOST else range(n)
    found: list[tuple[ContactSignature, ContactSignature]] = []
    for index in first:
        try:
            found.append((compute_frame_signature(one.frame(index)), compute_frame_signature(other.frame(index))))
        except TouchError:
            continue
    order = compare_signatures([a for a, _ in found], [b for _, b in found])
    return order if order is None else replace(order, lag_frames=round(order.lag_frames * max(1.0, n / _MOST)))


def compare_signatures(one: Sequence[ContactSignature], other: Sequence[ContactSignature]) -> SynchronyResult | None:
    """How moments of two streams go together, in this order; None where they are too few or too much alike to tell."""
    a, b = (np.array(felt, np.float64).reshape(-1, 3) for felt in (one, other))
    found = _by_chance(a, b)
    if found is None or found.p_value <= _BY_CHANCE:
        return found
    most = min(_MOST_LAGS, int(_LAGS * len(a)))
    lags = [lag for k in range(1, most + 1) for lag in (k, -k)]
    shifted = [(_by_chance(a[: len(a) - lag], b[lag:]) if lag > 0 else _by_chance(a[-lag:], b[:lag])) for lag in lags]
    agree = [(order.z_score, order.p_value, lag) for order, lag in zip(shifted, lags, strict=True) if order is not None]
    clear, best, lag = max(agree, default=(0.0, 1.0, 0))
    # What rises and falls slowly agrees with itself at many lags.
    alone = all(abs(other - lag) <= 1 or clear > _CLEARER * less for less, _, other in agree)
    return replace(found, lag_frames=lag if alone and best * len(lags) <= _SURELY else 0)


def _by_chance(a: Doubles, b: Doubles) -> SynchronyResult | None:
    both = (a[:, 0] > 0.0) & (b[:, 0] > 0.0)
    if np.count_nonzero(both) < _FEWEST:
        return None
    a, b = a[both], b[both]
    rng, found = np.random.default_rng(0), list[tuple[float, float]]()
    first, second = a[:, 0], b[:, 0]
    if min(float(s.std() / s.mean()) for s in (first, second)) >= _STRENGTHS:
        found.append(_as_well(first, second[_orders(len(a), rng)]))
    touched = _touched(first) & _touched(second)
    places = [felt[touched, 1:] for felt in (a, b)]
    if len(places[0]) >= _FEWEST and min(float(np.hypot(*p.std(axis=0))) for p in places) >= _PLACES:
        upper = np.triu_indices(len(places[0]), 1)
        first, second = (np.linalg.norm(p[:, None] - p[None], axis=2) for p in places)
        orders = _orders(len(second), rng)
        tried = second[orders[:, upper[0]], orders[:, upper[1]]]
        found.append(_as_well(first[upper], tried))
    if not found:
        return None
    by_chance, less = min((share, -clear) for share, clear in found)
    return SynchronyResult(n_moments=len(a), p_value=by_chance, z_score=-less)


def _touched(strength: Doubles) -> Mask:
    """Which moments (n,) are touches, where some are none."""
    log = np.log(strength)
    return log >= (log.min() + _TOUCHED * float(np.ptp(log)) if log.std() > _FAR_APART else log.min())


def _orders(n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """The order as it is, and random ones, (k, n)."""
    orders = np.tile(np.arange(n), (_ORDERS + 1, 1))
    orders[1:] = rng.permuted(orders[1:], axis=1)
    return orders


def _as_well(first: Doubles, tried: Doubles) -> tuple[float, float]:
    """Share of the orders that are tried, the first of which is the given one, that correlate as well as that.

    And by how many standard deviations it correlates better than they do.
    """
    others = tried - tried.mean(axis=1, keepdims=True)
    agreement = others @ (first - first.mean()) / np.maximum(np.linalg.norm(others, axis=1), 1e-30)
    clear = (agreement[0] - agreement.mean()) / max(float(agreement.std()), 1e-30)
    return float(np.mean(agreement >= agreement[0] - _ALIKE)), float(clear)
