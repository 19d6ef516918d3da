"""J^T J of any condition number from 1 to 1e16: what is too uncertain is named and frozen, and
only that.
"""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.geometry import rigid
from pipeline.stages.pose.registration.observability import TOLERANCES, assess_observability
from tests.pipeline.stages.pose.registration.test_registration import held_by_the_kernel
from tests.stability.rows import row
from tests.stability.scenes import rigid_motions, seeds

N = 1000.0
TOLERANCE_MM = 0.2
NEAR = 1e-6  # relative distance from a limit at which rounding may decide
ROUNDING = 1e-12
# share of the trace that a step is damped by, once for the damping and once for rounding
DAMPING = 2e-9


def information_of(powers, rng):
    """A symmetric (6, 6) of these eigenvalues 10**-power, turned at random, its trace that of
    unit normals or less.
    """
    turn = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    values = 10.0 ** -np.asarray(powers)
    return (turn * values) @ turn.T, turn, values


@row(
    10,
    "condition 1 to 1e16: a motion is weak if and only if its predicted deviation exceeds the "
    "tolerance",
)
@given(
    st.lists(st.floats(0, 16), min_size=6, max_size=6), st.floats(-3, 0).map(lambda e: 10**e), seeds
)
def test_weak_if_and_only_if_uncertain(powers, sigma_mm, seed):
    """Turns weigh as much as shifts here, so that the predicted deviation of an eigenvector is
    sigma / sqrt(n value).
    """
    rng = np.random.default_rng(seed)
    information, turn, values = information_of(powers, rng)
    n_held, step = held_by_the_kernel(information, np.full(6, sigma_mm**2 / N / TOLERANCE_MM**2))
    deviation_mm = sigma_mm / np.sqrt(N * values)
    # What float64 can hold relative to the largest eigenvalue.
    clear = np.abs(deviation_mm / TOLERANCE_MM - 1) > NEAR + 1e-13 * values.max() / values
    uncertain = deviation_mm > TOLERANCE_MM
    assert abs(n_held - int(uncertain.sum())) <= int((~clear).sum())
    if clear.all():
        kept = np.linalg.norm(step @ turn, axis=0)
        damped = DAMPING * values.sum() / values
        assert (np.abs(kept - ~uncertain) <= 1e-3 + np.where(uncertain, 0.0, damped)).all()
    assert np.isfinite(step).all()


@row(10, "a step has no part along what is frozen, whatever the condition")
@given(st.lists(st.floats(0, 16), min_size=6, max_size=6), seeds)
def test_frozen_directions_do_not_move(powers, seed):
    rng = np.random.default_rng(seed)
    information, turn, values = information_of(powers, rng)
    asked = np.full(6, np.deg2rad(3.0) ** 2 + 0.03**2 / N / TOLERANCE_MM**2)
    n_held, step = held_by_the_kernel(information, asked)
    held = turn[:, values < asked[0]]
    assert n_held == held.shape[1]
    assert np.abs(held.T @ step).max(initial=0.0) <= ROUNDING / (1e-9 * values.max())
    assert round(float(np.trace(step))) == 6 - n_held


def ridge(flatness, rng, n=300):
    """Points of a patch (n, 3) whose normals leave the z axis by up to `flatness` in both
    directions.
    """
    points = rng.uniform(-4, 4, (n, 3)) * (1, 1, 0.0)
    tilt = flatness * rng.uniform(-1, 1, (n, 2))
    normals = np.column_stack([tilt, np.ones(n)])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


@row(
    10,
    "a patch that grows flat: conditions 1 to 1e16 and beyond, no direction is claimed that is "
    "not there",
)
@given(st.floats(-9, 0).map(lambda e: 10**e), st.floats(-4, 0).map(lambda e: 10**e), seeds)
def test_flattening_patch(flatness, noise_mm, seed):
    rng = np.random.default_rng(seed)
    points, normals = ridge(flatness, rng)
    result = assess_observability(points, normals, points.mean(axis=0), noise_mm)
    assert np.isfinite(result.covariance).all()
    values = np.linalg.eigvalsh(result.covariance)
    assert values.min() > 0
    slide = np.zeros((6, 2))
    slide[3, 0] = slide[4, 1] = 1.0
    seen = np.linalg.norm(result.observable @ slide, axis=0)
    # Normals that lean less than the model's own error show nothing of a slide; ten times that,
    # with this noise, all.
    if flatness < np.deg2rad(TOLERANCES.normal_error_deg) / 3:
        assert seen.max() <= 0.2
        assert len(result.weak_directions) >= 3
    if flatness > 10 * np.deg2rad(TOLERANCES.normal_error_deg) and noise_mm < 0.05:
        assert seen.min() >= 0.9


@row(10, "two patches at an angle: the answer turns with the scene, whatever its condition")
@given(st.floats(-8, 0).map(lambda e: 10**e), rigid_motions(1e3), seeds)
def test_turns_with_the_scene(flatness, motion, seed):
    rng = np.random.default_rng(seed)
    points, normals = ridge(flatness, rng)
    here = assess_observability(points, normals, points.mean(axis=0), 0.02)
    there_points = rigid.apply(motion, points)
    there = assess_observability(
        there_points, normals @ motion[:3, :3].T, there_points.mean(axis=0), 0.02
    )
    assert len(here.weak_directions) == len(there.weak_directions)
    turn = np.kron(np.eye(2), motion[:3, :3])
    assert np.abs(turn @ here.observable @ turn.T - there.observable).max() <= 1e-6
