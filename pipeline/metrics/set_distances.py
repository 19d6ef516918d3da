"""Distances of two sets of touches as distributions of an encoder's features (n, features).

With few touches a Frechet distance is mostly its own bias, so it is only meaningful relative to that of two halves of
the true set. The kernel distance of paired touches is unbiased and 0 for equal sets; it may be slightly negative.
"""

import math
from collections.abc import Callable

import numpy as np

from pipeline.base.arrays import Doubles

MIN_TOUCHES = 4  # touches of a set needed for a covariance
Distance = Callable[[Doubles, Doubles], float]


def frechet_distance(a: Doubles, b: Doubles) -> float:
    """Return the squared Frechet distance (>= 0) of normal distributions fitted to rows (n, features).

    tr((S T)^1/2) of two covariances is the nuclear norm of the product of their factors, exact also for fewer touches
    than features; NaN for fewer than `MIN_TOUCHES`.
    """
    if min(len(a), len(b)) < MIN_TOUCHES:
        return math.nan
    shift = a.mean(axis=0) - b.mean(axis=0)
    one, other = (_factor(x) for x in (a, b))
    joint = float(np.linalg.svd(one @ other.T, compute_uv=False).sum())
    return max(0.0, float(shift @ shift) + float((one**2).sum() + (other**2).sum()) - 2.0 * joint)


def _factor(x: Doubles) -> Doubles:
    """Return R with R^T R the covariance of the rows of `x`, of minimal size."""
    return np.asarray(np.linalg.qr((x - x.mean(axis=0)) / math.sqrt(len(x) - 1), mode="r"), np.float64)


def kernel_distance(generated: Doubles, true: Doubles) -> float:
    """Return the unbiased squared maximum mean discrepancy of paired rows (n, features) of both sets; 0 = equal sets.

    The cubic kernel of Binkowski et al. 2018, (x.y / scale + 1)^3, where the scale is the mean squared length of the
    true features instead of their number: ours are thirty times as large as Inception's. Row i of both sets is the same
    touch, so that every mean is over the pairs i != j (Gretton et al. 2012, lemma 6): objects occur equally often in
    all terms, and no touch is set aside for a floor. NaN for fewer than `MIN_TOUCHES`.
    """
    n = len(true)
    if min(n, len(generated)) < MIN_TOUCHES:
        return math.nan
    scale = float((true**2).sum(axis=1).mean()) or 1.0

    def average_kernel(x: Doubles, y: Doubles) -> float:
        k = (x @ y.T / scale + 1.0) ** 3
        return float((k.sum() - np.trace(k)) / (n * (n - 1)))

    return average_kernel(generated, generated) + average_kernel(true, true) - 2.0 * average_kernel(generated, true)


def compare_halves(distance: Distance, generated: Doubles, true: Doubles) -> float:
    """Return the mean distance of one half of the generated set to the other half of the true set, both ways.

    Rows are pairs; the two halves share no touch, as in `compute_floor`, so that both distances have the same bias.
    """
    return 0.5 * (distance(generated[0::2], true[1::2]) + distance(generated[1::2], true[0::2]))


def compute_floor(distance: Distance, true: Doubles) -> float:
    """Return the distance of one half of the true set to its other half: the best possible value."""
    return distance(true[0::2], true[1::2])
