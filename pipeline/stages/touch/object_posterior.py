"""Posterior of an object's pose: equally likely poses that explain a touch, drawn around the
registered ones.

Determined motions vary as the registration's covariance says. Motions that the surface does not
determine vary over all scales up to a half turn, and are weighted by what the object would touch,
or fail to touch, there: the misfit that also ranks the registration's own poses, in units of its
independent patches.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.values.results import ObjectPose
from pipeline.stages.pose.registration.ranking import CORRELATION_MM, LEAST_SPREAD_MM, make_judge
from pipeline.stages.pose.registration.search import PoseSearch

_N_TRIED = 48  # around each registered pose
_MAX_MODES = 8  # registered poses that vary
# largest standard deviations of an undetermined motion
_LOOSE_MM = 2.0
_LOOSE_RAD = math.pi / 2
_LOG_SHARES = math.log(0.01), 0.0  # of those, the scales from which one is drawn
# of the registration's standard deviations, which leave out the depth's bias
_STD_FACTOR = 1.5
_LEAST_MM = 0.02
# points compared; a few milliseconds for all poses
_JUDGE_CONTACT = 150
_JUDGE_MODEL = 1500


@frozen
class PosePosterior:
    """Poses (n, 4, 4) of the object in the sensor frame that explain a touch."""

    modes: Doubles  # registered, best first
    samples: Doubles  # equally likely, around the modes


def sample_poses(search: PoseSearch, pose: ObjectPose, n: int, seed: int) -> PosePosterior:
    """Draw `n` poses around a registered pose and its alternatives.

    The same seed gives the same bytes.
    """
    assert pose.sensor_from_object is not None
    assert pose.covariance is not None
    rng = np.random.default_rng(seed)
    modes = np.array([pose.sensor_from_object, *pose.alternatives[: _MAX_MODES - 1]])
    motions = _draw_motions(pose.covariance, search.points.radius_mm, rng, len(modes))
    tried = np.concatenate(
        [rigid.apply_screw(m, own, search.middle_mm) for m, own in zip(modes, motions, strict=True)]
    )
    judge = make_judge(
        search.scene,
        search.object.grid,
        search.object.model,
        _JUDGE_CONTACT,
        _JUDGE_MODEL,
        search.max_distance_mm,
    )
    misfit_sq = judge.misfit_mm(tried) ** 2
    n_patches = max(1.0, search.scene.area_mm2 / (2.0 * math.pi * CORRELATION_MM**2))
    # the registration has compared more points
    worse_sq = np.maximum(misfit_sq - misfit_sq[0], 0.0)
    likelihood = np.exp(-0.5 * n_patches * worse_sq / max(float(misfit_sq[0]), LEAST_SPREAD_MM**2))
    share = np.cumsum(likelihood)
    # systematic: every mode by its weight
    chosen = np.searchsorted(share, share[-1] * (np.arange(n) + 0.5) / n)
    return PosePosterior(modes=freeze(modes), samples=freeze(tried[chosen]))


def _draw_motions(
    covariance: Doubles, radius_mm: float, rng: np.random.Generator, n_modes: int
) -> Doubles:
    """(modes, tried, 6) motions (rad, mm); the first of each mode is none."""
    to_mm = np.array([radius_mm] * 3 + [1.0] * 3)
    variances, axes = np.linalg.eigh(covariance * np.outer(to_mm, to_mm))
    turning = np.linalg.norm(axes[:3], axis=0)
    loose_mm = np.where(turning > math.sqrt(0.5), _LOOSE_RAD * radius_mm, _LOOSE_MM)
    std_mm = np.maximum(_STD_FACTOR * np.sqrt(np.maximum(variances, 0.0)), _LEAST_MM)
    drawn = rng.standard_normal((n_modes, _N_TRIED, 6))
    scale = np.exp(rng.uniform(*_LOG_SHARES, drawn.shape)) * loose_mm
    drawn *= np.where(std_mm > loose_mm, scale, std_mm)
    drawn[:, 0] = 0.0
    return drawn @ axes.T / to_mm
