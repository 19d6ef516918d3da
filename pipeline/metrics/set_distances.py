"""How far apart two sets of touches lie as sets, from what an encoder sees in each (n, features).

With few touches a Frechet distance is mostly the bias of its own estimate, so that it says something only beside what
two halves of the same true set give. The kernel distance has no such bias; it may come out a little below 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pipeline.base.arrays import Doubles

MIN_TOUCHES = 4  # touches of a set: below, there is no spread to speak of
Distance = Callable[[Doubles, Doubles], float]


def frechet_distance(a: Doubles, b: Doubles) -> float:
    """Squared Frechet distance of two normal distributions fitted to the rows of `a` and `b` (n, features), >= 0.

    tr((S T)^1/2) of two covariances is the nuclear norm of the product of their factors, exact also where there are
    fewer touches than features; NaN for fewer than `FEWEST`.
    """
    if min(len(a), len(b)) < MIN_TOUCHES:
        return math.nan
    shift = a.mean(axis=0) - b.mean(axis=0)
    one, other = (_factor(x) for x in (a, b))
    joint = float(np.linalg.svd(one @ other.T, compute_uv=False).sum())
    return max(0.0, float(shift @ shift) + float((one**2).sum() + (other**2).sum()) - 2.0 * joint)


def _factor(x: Doubles) -> Doubles:
    """R with R^T R the covariance of the rows of `x`: no larger than that."""
    return np.asarray(np.linalg.qr((x - x.mean(axis=0)) / math.sqrt(len(x) - 1), mode="r"), np.float64)


def kernel_distance(a: Doubles, b: Doubles) -> float:
    """Unbiased squared maximum mean discrepancy with the kernel (x.y / features + 1)^3 (Binkowski et al. 2018)."""
    if min(len(a), len(b)) < MIN_TOUCHES:
        return math.nan
    d = a.shape[1]

    def alike(x: Doubles, y: Doubles) -> Doubles:
        return (x @ y.T / d + 1.0) ** 3

    def within(x: Doubles) -> float:
        k = alike(x, x)
        return float((k.sum() - np.trace(k)) / (len(x) * (len(x) - 1)))

    return within(a) + within(b) - 2.0 * float(alike(a, b).mean())


def compare_halves(distance: Distance, made: Doubles, true: Doubles) -> float:
    """Mean distance of one half of what was made to the other half of what is true, both ways.

    Rows belong together in pairs; the two halves share no touch, as those of `floor` do not, so that both distances
    have the same bias.
    """
    return 0.5 * (distance(made[0::2], true[1::2]) + distance(made[1::2], true[0::2]))


def compute_floor(distance: Distance, true: Doubles) -> float:
    """The distance of one half of what is true to its other half: nothing can do better."""
    return distance(true[0::2], true[1::2])
