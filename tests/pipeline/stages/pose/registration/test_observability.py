from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from benchmarks.scenes import observability_score
from benchmarks.scenes.observability_patches import KINDS, draw_patch
from pipeline.core.geometry import rigid
from pipeline.core.values.results import DepthErrorModel
from pipeline.stages.pose.registration.observability import (
    MIN_NOISE_MM,
    SystematicStd,
    Tolerances,
    assess_observability,
    compute_correlated_covariance,
    estimate_systematic_error,
)

NORMAL_NOISE_DEG = 2.0  # in each of two directions: crooked gradients of a distance grid
NOISE_MM = 0.03
N = 1200


def patch(kind: str, seed: int, pose=None, n: int = N):
    made = draw_patch(kind, np.random.default_rng(seed), n)
    return made if pose is None else made.transform(pose)


def crooked(normals, seed: int, deg: float = NORMAL_NOISE_DEG):
    off = normals + math.radians(deg) * np.random.default_rng([seed, 7]).standard_normal(
        normals.shape
    )
    return off / np.linalg.norm(off, axis=1, keepdims=True)


def test_covariances_do_not_depend_on_the_number_of_threads():
    points = np.random.default_rng(5).normal(size=(40_000, 3))  # BLAS distributes sums of that many
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)

    def assess(n_threads: int) -> tuple[bytes, bytes]:
        with threadpool_limits(n_threads, user_api="blas"):
            result = assess_observability(points, normals, points.mean(axis=0), NOISE_MM)
            covariance = compute_correlated_covariance(
                points,
                normals,
                points.mean(axis=0),
                result.observable,
                noise_mm=NOISE_MM,
                error=DepthErrorModel(rms_mm=0.05, correlation_mm=0.3),
            )
        return result.covariance.tobytes(), covariance.tobytes()

    assert assess(1) == assess(2)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**31),
    noise_mm=st.floats(0.0, 0.05),
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_every_motion_nobody_can_feel_is_named_and_no_other(kind, seed, noise_mm, turn):
    pose = rigid.rotation(turn)
    pose[:3, 3] = (5.0, -8.0, 20.0)
    contact = patch(kind, seed, pose)
    together = 0.1 * noise_mm  # of a smooth error, as of pixels that hang together over 0.15 mm
    middle = contact.points_mm.mean(axis=0)
    result = assess_observability(
        contact.points_mm,
        crooked(contact.normals, seed),
        middle,
        noise_mm,
        systematic_error=SystematicStd(translation_mm=together, rotation_mm=together),
    )
    truth = observability_score.compute_true_motions(
        patch(kind, seed, pose, 5 * N),
        1.0,
        math.hypot(max(noise_mm, MIN_NOISE_MM) / math.sqrt(N), together),
        Tolerances(),
    )
    score = observability_score.score_named_motions(result.weak_motions, middle, truth)
    assert score.n_named == score.n_weak >= len(contact.free)
    assert score.n_false == 0
    assert len(result.weak_directions) == len(result.weak_motions)
    np.testing.assert_allclose(result.observable @ result.observable, result.observable, atol=1e-8)


def test_the_score_notices_what_is_missed_and_what_is_made_up():
    contact = patch("rod", 1)
    truth = observability_score.compute_true_motions(contact, N, NOISE_MM, Tolerances())
    middle = contact.points_mm.mean(axis=0)
    slide = np.eye(6)[3:4]
    across = np.eye(6)[4:5]
    missed = observability_score.score_named_motions(slide, middle, truth)
    assert (missed.recall, missed.precision) == (0.5, 1.0)
    made_up = observability_score.score_named_motions(across, middle, truth)
    assert (made_up.recall, made_up.precision) == (0.0, 0.0)


def test_words_tell_the_axis_and_a_point_on_it():
    rod = patch("rod", 2).transform(rigid.translation(1.0, 2.0, 20.0))
    result = assess_observability(rod.points_mm, rod.normals, rod.points_mm.mean(axis=0), NOISE_MM)
    x_mm = rod.points_mm[:, 0].mean()  # the point of the axis that is nearest to the contact
    assert result.weak_directions == (
        "moves along x",
        f"rotates about x with its axis at ({x_mm:.1f}, 2.0, 20.0) mm",
    )
    ball = patch("sphere", 2).transform(rigid.translation(0.0, 0.0, 30.0))
    result = assess_observability(
        ball.points_mm, ball.normals, ball.points_mm.mean(axis=0), NOISE_MM
    )
    assert result.weak_directions == tuple(
        f"rotates about {axis} with its axis at (0.0, 0.0, 30.0) mm" for axis in "xyz"
    )
    plate = patch("plane", 2)
    result = assess_observability(
        plate.points_mm, plate.normals, plate.points_mm.mean(axis=0), NOISE_MM
    )
    assert result.weak_directions == ("moves along x", "moves along y", "rotates about z")
    skew = rod.transform(rigid.rotation([0.0, 0.0, math.radians(30.0)]))
    result = assess_observability(
        skew.points_mm, skew.normals, skew.points_mm.mean(axis=0), NOISE_MM
    )
    assert result.weak_directions[0] == "moves along (0.87, 0.50, 0.00)"


def test_a_helix_is_a_turn_with_a_slide():
    rng = np.random.default_rng(5)
    angle = rng.uniform(-math.pi, math.pi, N)
    away = rng.uniform(1.0, 3.0, N)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(N)], axis=1)
    around = np.stack([-np.sin(angle), np.cos(angle), np.zeros(N)], axis=1)
    pitch_mm = 1.5  # per radian
    normals = -pitch_mm * around + away[:, None] * np.eye(3)[2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = away[:, None] * out + pitch_mm * angle[:, None] * np.eye(3)[2]
    result = assess_observability(points, normals, points.mean(axis=0), 1e-3)
    assert result.weak_directions == ("rotates about z while moving along z",)


def test_a_fine_screw_keeps_the_slide_that_goes_with_its_turn():
    rng = np.random.default_rng(6)
    angle = rng.uniform(-math.pi, math.pi, N)
    away = rng.uniform(2.0, 4.0, N)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(N)], axis=1)
    around = np.stack([-np.sin(angle), np.cos(angle), np.zeros(N)], axis=1)
    pitch_mm = 0.3  # per radian: a thread of 1.9 mm
    normals = -pitch_mm * around + away[:, None] * np.eye(3)[2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = away[:, None] * out + pitch_mm * angle[:, None] * np.eye(3)[2]
    result = assess_observability(points, normals, points.mean(axis=0), 1e-3)
    assert "rotates about z while moving along z" in result.weak_directions[-1]


@pytest.mark.parametrize("sides", [64, 96, 200])
def test_facets_of_a_round_rod_do_not_pass_for_knowledge_of_its_roll(sides):
    made = draw_patch("rod", np.random.default_rng(3), 3000)
    step = 2 * math.pi / sides
    angle = (np.floor(np.arctan2(made.normals[:, 1], made.normals[:, 2]) / step) + 0.5) * step
    facets = np.stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)], axis=1)
    result = assess_observability(made.points_mm, facets, made.points_mm.mean(axis=0), 0.0)
    assert len(result.weak_directions) == 2
    roll = np.concatenate([[1.0, 0.0, 0.0], np.cross([1.0, 0.0, 0.0], made.points_mm.mean(axis=0))])
    assert np.linalg.norm(result.observable @ roll) < 0.05 * np.linalg.norm(roll)


@pytest.mark.parametrize("kind", ["rod", "plane", "sphere", "edge"])
def test_gradients_that_are_wrong_cell_by_cell_do_not_pass_for_knowledge_either(kind):
    contact = patch(kind, 12)
    cell = np.unique(np.floor(contact.points_mm / 0.5), axis=0, return_inverse=True)[1].ravel()
    off = math.radians(NORMAL_NOISE_DEG) * np.random.default_rng(1).standard_normal(
        (cell.max() + 1, 3)
    )
    normals = contact.normals + off[cell]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    result = assess_observability(contact.points_mm, normals, contact.points_mm.mean(axis=0), 0.0)
    assert len(result.weak_directions) == len(contact.free)


def test_a_hexagonal_rod_knows_its_roll():
    rng = np.random.default_rng(3)
    side = rng.integers(-1, 2, N)
    across = rng.uniform(-0.577, 0.577, N)
    along = rng.uniform(-4.0, 4.0, N)
    angle = side * math.pi / 3
    normals = np.stack([np.zeros(N), np.sin(angle), np.cos(angle)], axis=1)
    points = (
        3.0 * (normals + across[:, None] * np.cross(normals, [1.0, 0.0, 0.0]))
        + along[:, None] * np.eye(3)[0]
    )
    result = assess_observability(points, normals, points.mean(axis=0), NOISE_MM)
    assert result.weak_directions == ("moves along x",)


def test_no_variance_is_claimed_where_only_crooked_normals_see_something():
    rod = patch("rod", 4)
    result = assess_observability(
        rod.points_mm, crooked(rod.normals, 4), rod.points_mm.mean(axis=0), NOISE_MM
    )
    assert math.sqrt(result.covariance[3, 3]) > 10.0, "mm along the rod"
    known = result.observable @ result.covariance @ result.observable.T
    assert np.sqrt(np.diag(known)).max() < 0.05, "rad and mm of what is determined"


def test_a_bias_widens_the_covariance_as_it_should():
    tool = patch("tool", 6)
    middle = tool.points_mm.mean(axis=0)
    plain = assess_observability(tool.points_mm, tool.normals, middle, NOISE_MM)
    biased = assess_observability(
        tool.points_mm,
        tool.normals,
        middle,
        NOISE_MM,
        systematic_error=SystematicStd(translation_mm=0.005, rotation_mm=0.005),
    )
    grown = 1 + 0.005**2 * N / NOISE_MM**2
    np.testing.assert_allclose(biased.covariance, grown * plain.covariance, rtol=1e-9)


def test_what_lasts_of_a_smooth_error_is_what_planes_through_drawn_ones_are_off():
    rng = np.random.default_rng(12)
    far_mm = 3.0
    error = DepthErrorModel(rms_mm=0.08, correlation_mm=4.4)
    points = np.column_stack([rng.uniform(-far_mm, far_mm, (120, 2)), np.full(120, 20.0)])
    apart_sq = ((points[:, None] - points[None]) ** 2).sum(axis=-1)
    together = error.rms_mm**2 * np.exp(-0.5 * apart_sq / error.correlation_mm**2) + 1e-12 * np.eye(
        120
    )
    drawn_mm = np.linalg.cholesky(together) @ rng.standard_normal((120, 4000))
    middle = points.mean(axis=0)
    x = (points - middle)[:, 0]
    y = (points - middle)[:, 1]
    shift, along_x, along_y = np.linalg.lstsq(
        np.column_stack([np.ones(120), x, y]), drawn_mm, rcond=None
    )[0]
    result = estimate_systematic_error(points, np.tile([0.0, 0.0, 1.0], (120, 1)), middle, error)
    assert result.translation_mm == pytest.approx(float(np.sqrt((shift**2).mean())), rel=0.05)
    # a turn of 1 rad moves the contact by its square root
    seen_mm2 = 0.5 * ((x**2).mean() + (y**2).mean())
    tilts = np.sqrt(0.5 * ((along_x**2).mean() + (along_y**2).mean()) * seen_mm2)
    assert result.rotation_mm == pytest.approx(float(tilts), rel=0.08)
    assert result.rotation_mm < 0.5 * result.translation_mm


def test_the_answer_does_not_depend_on_the_frame():
    pose = rigid.rotation([0.3, -1.1, 0.7])
    pose[:3, 3] = (40.0, -7.0, 90.0)
    one = patch("cone", 11)
    other = one.transform(pose)
    a = assess_observability(one.points_mm, one.normals, one.points_mm.mean(axis=0), NOISE_MM)
    b = assess_observability(other.points_mm, other.normals, other.points_mm.mean(axis=0), NOISE_MM)
    turn = np.kron(np.eye(2), pose[:3, :3])
    np.testing.assert_allclose(turn @ a.observable @ turn.T, b.observable, atol=1e-8)


def test_too_little_of_anything_leaves_everything_open():
    point = np.array([[1.0, 2.0, 3.0]] * 3)
    result = assess_observability(point, np.tile([0.0, 0.0, 1.0], (3, 1)), point.mean(axis=0), 0.05)
    assert np.isfinite(result.covariance).all()
    assert np.isfinite(result.weak_motions).all()
    assert len(result.weak_directions) == 5


@pytest.mark.parametrize("correlation_mm", [0.2, 1.5, 8.0])
def test_errors_that_go_together_widen_each_motion_as_draws_of_them_do(correlation_mm):
    tool = patch("tool", 5, np.eye(4), 300)
    middle = tool.points_mm.mean(axis=0)
    error = DepthErrorModel(rms_mm=0.03, correlation_mm=correlation_mm)
    known = assess_observability(tool.points_mm, tool.normals, middle, 0.01).observable
    result = compute_correlated_covariance(
        tool.points_mm, tool.normals, middle, known, noise_mm=0.01, error=error
    )
    apart = np.linalg.norm(tool.points_mm[:, None] - tool.points_mm[None], axis=-1)
    drawn = error.rms_mm**2 * np.exp(-0.5 * (apart / correlation_mm) ** 2) + 0.01**2 * np.eye(300)
    jacobian = np.concatenate(
        [np.cross(tool.points_mm - middle, tool.normals), tool.normals], axis=1
    )
    moved = (
        np.linalg.pinv(jacobian)
        @ np.linalg.cholesky(drawn)
        @ np.random.default_rng(0).standard_normal((300, 4000))
    )
    np.testing.assert_allclose(np.sqrt(np.diag(result)), moved.std(axis=1), rtol=0.05)
