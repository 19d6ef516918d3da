import itertools

import numpy as np
import pytest

from pipeline.core.errors import SettingProblem
from pipeline.io import open_recording
from pipeline.lab.tasks import marble
from pipeline.lab.tasks.marble import (
    EXPERT,
    MAX_STEP_MM,
    N_TICKS,
    RADIUS_MM,
    SOURCE,
    START_MM,
    TARGET,
    ClonedPolicyTask,
    draw_trial,
    is_held,
    limit_step,
    make_ball,
    roll,
    run_trial,
    shrink_image,
)
from pipeline.lab.tasks.rollout_file import write_rollout
from pipeline.lab.tasks.runner import make_jobs, run_job, run_jobs
from pipeline.lab.tasks.task import TrialPlan
from pipeline.lab.tasks.touches import OWN

# the first touch compiles kernels where `tactoscope prepare` has not
pytestmark = pytest.mark.timeout(600)
PLAN = TrialPlan(
    task="marble", case="marble", index=0, touches=("true",), tolerances_mm=(1.0,), seed=3, vary=1.0
)


@pytest.fixture
def few_ticks(monkeypatch):
    monkeypatch.setattr(marble, "N_TICKS", 2)


@pytest.mark.parametrize("index", range(3))
def test_the_expert_holds_the_ball_from_every_start_and_without_motion_it_stays(index):
    trial = draw_trial(0, index, 1.0)
    assert START_MM[0] <= np.hypot(*trial.start_mm) <= START_MM[1]
    run = roll(trial, EXPERT)
    assert is_held(run, 0.05)
    assert len(run.decisions) == N_TICKS
    assert max(one.error_mm for one in run.decisions) == 0.0
    assert roll(trial, "none").distances_mm[-1] == pytest.approx(
        np.hypot(*trial.start_mm), rel=0.01
    )


def test_both_sensors_see_the_whole_contact_where_it_is():
    trial = draw_trial(0, 1, 0.0)
    ball = trial.start()
    for name in (SOURCE, TARGET):
        frame, truth = trial.record(name, ball, 0)
        assert frame.sensor == name
        place = trial.source if name == SOURCE else trial.target
        rows, cols = np.nonzero(truth.contact)
        x = cols.mean() - place.nominal.camera.cx_px
        y = rows.mean() - place.nominal.camera.cy_px
        assert place.nominal.pixel_mm * np.array([x, y]) == pytest.approx(ball.contact_mm, abs=0.2)
        assert 0 < rows.min() < rows.max() < frame.image.shape[0] - 1
        assert 0 < cols.min() < cols.max() < frame.image.shape[1] - 1


def test_the_load_indents_the_gel_of_the_target_as_drawn():
    trial = draw_trial(0, 2, 1.0)
    ball = trial.start()
    tick = ball.move_plate(np.zeros(2))
    assert tick.force_n[2] == pytest.approx(trial.load_n, rel=0.05)
    assert 0.1 < trial.load_n < 20.0


def test_the_mesh_is_the_ball():
    radius = np.linalg.norm(make_ball().vertices_mm, axis=1)
    assert radius == pytest.approx(RADIUS_MM)


@pytest.mark.parametrize("length", [0.0, 0.3, 5.0])
def test_a_step_keeps_its_direction_and_its_limit(length):
    step = length * np.array([0.6, -0.8])
    assert np.linalg.norm(limit_step(step)) == pytest.approx(min(length, MAX_STEP_MM))
    assert limit_step(step) @ np.array([0.8, 0.6]) == pytest.approx(0.0, abs=1e-12)


def test_the_cloned_policy_holds_the_ball_by_the_true_touch():
    (rollout,) = run_trial(PLAN)
    assert rollout.succeeds, rollout.cause
    assert rollout.measures["held_mm"] <= 1.0


@pytest.mark.slow  # some eighty translated touches
def test_a_failed_rollout_is_attributed_and_is_a_recording(few_ticks, tmp_path):
    plan = TrialPlan(
        task="marble",
        case="marble",
        index=0,
        touches=("t2d2", OWN),
        tolerances_mm=(0.001,),
        seed=3,
        vary=1.0,
        attribute=True,
        record_frames=True,
    )
    for rollout in run_trial(plan):
        (decision,) = [one for one in rollout.decisions if one.shares]
        assert [part.stage for part in decision.shares][-2:] == ["touch", "policy"]
        assert sum(part.share_mm for part in decision.shares) == pytest.approx(decision.error_mm)
        assert decision.shares[-1].remaining_mm == 0.0
        assert decision.error_mm == max(one.error_mm for one in rollout.decisions)
    path = tmp_path / "rollout.h5"
    write_rollout(rollout, path, "key", plan)
    recording = open_recording(path)
    assert [(one.sensor, one.n_frames) for one in recording.streams] == [(SOURCE, 2), (TARGET, 2)]
    assert recording.target_from_source("digit_plate", "gelslim_plate") is not None
    recording.close()


def test_the_same_seed_gives_the_same_rollouts_on_any_number_of_processes():
    jobs = make_jobs("marble", touches=(EXPERT, "none"), n_trials=2)
    assert run_jobs(jobs, 2) == [one for job in jobs for one in run_job(job)]


def test_demonstrations_are_of_the_expert_and_the_same_on_every_call():
    task = ClonedPolicyTask(n_demonstrations=1, n_ticks=2)
    first, again = (task.make_validation_example("unseen_grasps", 1) for _ in range(2))
    assert first["image"].shape == (3, 48, 64)
    assert first["image"].tobytes() == again["image"].tobytes()
    assert 0.0 < np.linalg.norm(first["step"]) <= MAX_STEP_MM + 1e-6


def test_any_image_becomes_the_networks_input():
    for rows, cols in itertools.product((48, 320), (64, 240)):
        image = np.full((rows, cols, 3), (255, 0, 51), np.uint8)
        assert shrink_image(image).reshape(3, -1).mean(axis=1) == pytest.approx(
            (1.0, 0.0, 0.2), abs=1e-6
        )


def test_further_touches_are_of_this_task_alone():
    assert make_jobs("marble", touches=(OWN,))[0].plan.touches == (OWN,)
    with pytest.raises(SettingProblem, match=EXPERT):
        make_jobs("insertion", touches=(EXPERT,))


def test_the_scene_has_the_plate_under_the_ball():
    (plate,) = marble.build_scene(None).bodies
    assert plate.parent == "hand"  # which is the plate in every tick
    assert plate.mesh.vertices_mm[:, 2].max() == 0.0
    assert np.ptp(plate.mesh.vertices_mm, axis=0)[:2] == pytest.approx((18.0, 13.5))
