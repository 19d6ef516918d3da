import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.lab.tasks.grasp import (
    FINGERS,
    PlanarPose,
    feel_grasp,
    press_between_fingers,
    project_to_plane,
)
from pipeline.lab.tasks.insertion import (
    FORCE_LIMIT_N,
    SHORT_MM,
    TASK,
    load_tool,
    make_tool,
    measure_miss_mm,
    run,
)
from pipeline.lab.tasks.rollout_file import read_summary, summarise, write_rollout
from pipeline.lab.tasks.runner import make_jobs, run_job, run_jobs
from pipeline.lab.tasks.task import Disturbance, Rollout, TrialPlan, parse_disturbance

# the first grasp compiles kernels where `tactoscope prepare` has not
pytestmark = pytest.mark.timeout(600)
PLAN = TrialPlan(
    task="insertion",
    case="hex_key",
    index=0,
    touches=("true", "none"),
    tolerances_mm=(1.0,),
    seed=0,
    attribute=True,
)


@pytest.fixture(scope="module")
def rollouts():
    return run(PLAN)


def test_true_bubble_inserts_and_the_planned_grasp_does_not(rollouts):
    true, none = rollouts
    assert true.succeeds
    assert true.decisions[0].error_mm < 0.5
    assert not none.succeeds


def test_shares_of_a_failed_decision_add_up_and_the_truth_inserts(rollouts):
    decision = rollouts[1].decisions[0]
    assert sum(part.share_mm for part in decision.shares) == pytest.approx(decision.error_mm)
    assert decision.shares[-1].succeeds
    assert "with the true pose estimation it succeeds" in rollouts[1].cause


def test_the_source_itself_inserts_without_a_translation():
    (own,) = run(replace(PLAN, touches=("own",), attribute=False))
    assert own.succeeds
    assert own.decisions[0].error_mm < 0.5


def test_the_descent_ends_at_full_depth(rollouts):
    inserted = rollouts[0]
    full_mm = make_tool("hex_key").peg.depth_mm
    assert full_mm - SHORT_MM <= inserted.measures["depth_mm"] < full_mm + 1.0
    assert inserted.measures["largest_force_n"] < 0.5 * FORCE_LIMIT_N


def test_rollout_is_a_recording(rollouts, tmp_path):
    path = tmp_path / "rollout.h5"
    write_rollout(rollouts[0], path, "key", PLAN)
    recording = open_recording(path)
    assert [stream.name for stream in recording.streams] == [
        "soft_bubble_left",
        "soft_bubble_right",
    ]
    assert recording.streams[0].truth(0) is not None
    recording.close()
    assert read_summary(path, "key") == summarise(rollouts[0])
    assert read_summary(path, "another key") is None


@pytest.mark.parametrize("finger", FINGERS)
def test_both_fingers_press_the_same_grasp(finger):
    tool = make_tool("spanner")
    grasp = PlanarPose(x_mm=2.0, y_mm=-1.0, angle_rad=0.4)
    pose = press_between_fingers(tool.mesh, grasp, finger, 0.5)
    lowest = (
        pose @ np.column_stack([tool.mesh.vertices_mm, np.ones(len(tool.mesh.vertices_mm))]).T
    )[2].min()
    assert lowest == pytest.approx(-0.5, abs=0.2)
    mirrored = 1.0 if finger == "left" else -1.0
    seen = project_to_plane(pose)
    assert (seen.x_mm, mirrored * seen.y_mm) == pytest.approx((2.0, -1.0))


@settings(max_examples=10, deadline=None)
@given(st.floats(0.0, 5.0), st.floats(0.0, 15.0), st.floats(0.0, 5.0), st.integers(0, 99))
def test_a_disturbance_is_as_large_as_asked_and_leaves_the_start(slip, tilt, alignment, index):
    plan = replace(PLAN, touches=("none",), attribute=False, index=index)
    disturbance = Disturbance(slip=slip, tilt=tilt, alignment=alignment)
    mesh = make_tool("pencil").mesh
    calm = feel_grasp(plan, mesh, "pencil")
    grasp = feel_grasp(replace(plan, disturbance=disturbance), mesh, "pencil")
    assert calm.acted == calm.held
    assert calm.held == replace(grasp.held, tilt_rad=calm.held.tilt_rad)
    moved = np.subtract(grasp.acted.matrix, grasp.held.matrix)
    assert np.linalg.norm(moved) == pytest.approx(slip, abs=1e-9)
    assert math.hypot(*grasp.held.tilt_rad) == pytest.approx(math.radians(tilt))
    off = grasp.source.alignment_from_sensor @ np.linalg.inv(calm.source.alignment_from_sensor)
    assert np.linalg.norm(off[:3, 3]) == pytest.approx(alignment, abs=1e-9)
    cosine = 0.5 * float(np.trace(off[:3, :3])) - 0.5
    assert math.degrees(math.acos(min(1.0, cosine))) == pytest.approx(2.0 * alignment, abs=1e-4)


def test_a_slip_is_an_error_of_its_own():
    """The bubble feels the grasp before the slip: what it adds is attributed to it alone."""
    plan = replace(PLAN, touches=("true",), disturbance=Disturbance(slip=3.0))
    (rollout,) = run(plan)
    decision = rollout.decisions[0]
    assert not rollout.succeeds
    assert decision.error_mm > 1.0
    assert sum(part.share_mm for part in decision.shares) == pytest.approx(decision.error_mm)
    assert decision.shares[-1].title == "slip"
    assert decision.shares[-1].share_mm == pytest.approx(decision.error_mm, abs=0.5)


def test_an_alignment_error_misleads_the_source_and_not_the_target():
    plan = replace(PLAN, touches=("own", "true"), attribute=False)
    calm = run(plan)
    moved = run(replace(plan, disturbance=Disturbance(alignment=2.0)))
    assert moved[0].decisions[0].error_mm > calm[0].decisions[0].error_mm + 0.2
    assert moved[1].decisions == calm[1].decisions


def test_miss_is_the_lateral_offset_of_the_worse_end():
    tool = make_tool("pencil")
    held = PlanarPose()
    assert measure_miss_mm(tool.peg, held, PlanarPose(y_mm=0.7)) == pytest.approx(0.7)
    assert measure_miss_mm(tool.peg, held, PlanarPose(x_mm=0.7)) == pytest.approx(0.0)
    tilt = measure_miss_mm(tool.peg, held, PlanarPose(angle_rad=math.radians(5.0)))
    assert tilt == pytest.approx(tool.peg.tip_mm * math.sin(math.radians(5.0)))


def test_same_seed_gives_the_same_rollouts_on_any_number_of_processes():
    options = {"touches": ("none",), "cases": ("pencil",), "n_trials": 2, "tolerances_mm": (1.0,)}
    alone = [one for job in make_jobs("insertion", **options) for one in run_job(job)]
    assert run_jobs(make_jobs("insertion", **options), 2) == alone


@pytest.fixture
def toy(monkeypatch):
    """A task of one line: every trial succeeds at once; its runs are counted."""
    runs = []

    def run_toy(plan):
        runs.append(plan.index)
        return (
            Rollout(
                case=plan.case,
                trial=plan.index,
                touch=plan.touches[0],
                tolerance_mm=plan.tolerances_mm[0],
                succeeds=True,
                cause="done",
                measures={"x": 1.0 / 3.0},
                decisions=(),
                frames=(
                    (
                        "gelslim_left",
                        TactileFrame(
                            sensor="gelslim", image=np.zeros((4, 5, 3), np.uint8), reference=None
                        ),
                        None,
                    ),
                ),
            ),
        )

    task = replace(TASK, name="toy", cases=("toy",), run=run_toy)
    monkeypatch.setattr("pipeline.lab.tasks.runner.load_task", lambda _name: task)
    return runs


def test_finished_rollouts_are_read_and_not_run_again(tmp_path, toy):
    (job,) = make_jobs("toy", touches=("none",), n_trials=1, tolerances_mm=(1.0,), folder=tmp_path)
    first = run_job(job)
    assert run_job(job) == first
    assert toy == [0]
    (other,) = make_jobs(
        "toy", touches=("none",), n_trials=1, tolerances_mm=(1.0,), folder=tmp_path, seed=1
    )
    run_job(other)
    assert toy == [0, 0]


def test_tool_of_a_toml_file_is_inserted(tmp_path):
    mesh = make_tool("spanner").mesh
    (tmp_path / "mine.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices_mm)
        + "".join(f"f {a} {b} {c}\n" for a, b, c in mesh.triangles + 1)
    )
    path = tmp_path / "mine.toml"
    path.write_text("mesh = 'mine.obj'\ndepth_mm = 6.0\n")
    (job,) = make_jobs(str(path), touches=("none",), n_trials=1, tolerances_mm=(1.0,))
    (summary,) = run_job(job)
    assert summary["case"] == "mine"
    assert load_tool(path).peg.depth_mm == 6.0


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"cases": ("cup",)}, "cup"),
        ({"touches": ("nothing",)}, "nothing"),
        ({"tolerances_mm": (-1.0,)}, "tolerance"),
        ({"n_trials": -1}, "trials"),
    ],
)
def test_wrong_options_are_named(options, word):
    with pytest.raises(SettingProblem, match=word):
        make_jobs(TASK.name, **options)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("slip", "--disturb slip: slip must be a number"),
        ("slip=-1", "--disturb slip=-1: slip must lie within 0 and 10 mm"),
        ("fall=1", "there are slip, tilt, alignment"),
    ],
)
def test_wrong_disturbances_are_named(text, word):
    with pytest.raises(SettingProblem, match=word):
        parse_disturbance([text])


def test_a_task_without_a_grasp_is_not_disturbed():
    with pytest.raises(SettingProblem, match="marble has none"):
        make_jobs("marble", disturbance=parse_disturbance(["slip=1"]))
    (job,) = make_jobs("stack", n_trials=1, disturbance=parse_disturbance(["slip=1", "tilt=2"]))
    assert job.plan.disturbance == Disturbance(slip=1.0, tilt=2.0)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("mesh = 'a.stl'", "depth_mm: it is missing"),
        ("mesh = 'a.stl'\ndepth_mm = 'deep'", "depth_mm: expected a number, got a text"),
        ("mesh = 'a.stl'\ndepth_mm = nan", "depth_mm: expected a number"),
        ("mesh = 'a.stl'\ndepth_mm = 5\nhole = 2", "hole"),
        ("mesh = 'a.stl'\ndepth_mm = 5\nface = 'up'", "face: Invalid enum value 'up'"),
        ("mesh = 5\ndepth_mm = 5", "mesh: expected a text"),
        ("[", "TOML"),
    ],
)
def test_damaged_task_file_is_named(tmp_path, text, word):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(FileProblem, match=rf"{word}.*mine\.toml"):
        load_tool(path)
