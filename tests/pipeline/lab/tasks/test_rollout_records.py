"""Recorded rollouts: rows of a folder, reading, running again, attribution."""

import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest

from pipeline.core.errors import FileProblem
from pipeline.core.progress import Cancelled
from pipeline.lab.tasks.insertion import make_tool
from pipeline.lab.tasks.rerun import (
    attribute_rollout,
    compare_rollouts,
    copy_case,
    replay_rollout,
    run_again,
    write_rollout_bundle,
)
from pipeline.lab.tasks.rollout_file import read_rollout
from pipeline.lab.tasks.runner import make_jobs, run_job
from pipeline.lab.tasks.scene_view import build_scene, cut_dashes, find_edges, make_box
from pipeline.lab.tasks.task import describe_error, load_task
from pipeline.lab.tasks.trial_rows import compute_error_deg, is_rollout_folder, list_trials

# the first grasp compiles kernels where `tactoscope prepare` has not
pytestmark = pytest.mark.timeout(600)
FAILS = "hex_key_t2t_0.1mm_003.h5"


@pytest.fixture(scope="module")
def failed(rollout_folder):
    return read_rollout(rollout_folder / FAILS)


def test_rows_of_a_folder_hold_outcome_and_errors(rollout_folder):
    rows = {row.path.name: row for row in list_trials(rollout_folder)}
    assert [row.outcome for row in rows.values()] == ["fails", "fails", "fails", "succeeds"]
    assert {(row.task, row.case, row.trial) for row in rows.values()} == {
        ("insertion", "hex_key", 3)
    }
    row = rows[FAILS]
    assert (row.touch, row.tolerance_mm) == ("t2t", 0.1)
    assert row.error_mm == pytest.approx(0.2977, abs=0.01)
    assert row.error_deg == pytest.approx(2.234, abs=0.05)
    assert row.cause.startswith("jams")
    assert list_trials(rollout_folder / FAILS) == tuple(rows.values())


def test_recorded_rollout_has_ticks_of_one_moment_each(failed):
    assert failed.n_ticks == len(failed.force_n) == len(failed.world_from_object) > 20
    assert (np.diff(failed.time_s) > 0).all()
    assert np.linalg.norm(failed.force_n, axis=1).max() == pytest.approx(
        failed.summary.measures["largest_force_n"]
    )
    assert [failed.find_decision(tick) for tick in (0, failed.n_ticks - 1)] == [0, 0]


def test_estimate_lies_off_the_object_as_the_decision_says(failed):
    scene = load_task("insertion").build_scene(failed)
    decision = failed.summary.decisions[0]
    held = np.linalg.inv(failed.world_from_hand[0]) @ failed.world_from_object[0]
    off = scene.hand_from_estimate(decision)[:3, 3] - held[:3, 3]
    gaps = [decision.estimate[name] - decision.truth[name] for name in ("x_mm", "y_mm")]
    np.testing.assert_allclose(off, [*gaps, 0.0], atol=1e-5)
    np.testing.assert_allclose(
        scene.hand_from_estimate(replace(decision, estimate=decision.truth)), held, atol=1e-5
    )


def test_run_again_it_is_the_recorded_one_and_its_shares_add_up_and_flip(failed):
    steps = []

    class Steps:
        def step(self, fraction, text):
            steps.append((fraction, text))

    decisions = attribute_rollout(failed, Steps())
    shares = decisions[0].shares
    assert sum(part.share_mm for part in shares) == pytest.approx(decisions[0].error_mm)
    assert max(shares, key=lambda part: part.share_mm).stage == "touch"
    assert next(part for part in shares if part.succeeds).stage == "touch"
    sentence = describe_error(decisions[0], "off the hole's axis", succeeds=True)
    assert sentence.startswith("0.3 mm off the hole's axis; it succeeds")
    sentence = describe_error(decisions[0], "off the hole's axis", succeeds=False)
    assert sentence.startswith("fails by 0.3 mm off the hole's axis; of it 0.3 the generated touch")
    assert sentence.endswith("with the true touch it succeeds")
    fractions = [fraction for fraction, _ in steps]
    assert fractions == sorted(fractions)
    assert any("truth in place of generated touch" in text for _, text in steps)


def test_stored_shares_are_not_computed_again(failed, monkeypatch):
    monkeypatch.setattr(
        "pipeline.lab.tasks.rerun.run_again", lambda *_, **__: pytest.fail("run again")
    )
    known = replace(failed.summary.decisions[0], shares=(object(),))
    stored = replace(failed, summary=replace(failed.summary, decisions=(known,)))
    assert attribute_rollout(stored) == (known,)


def test_attribution_ends_when_it_is_cancelled(failed):
    class Cancel:
        def step(self, fraction, text):
            raise Cancelled

    with pytest.raises(Cancelled):
        attribute_rollout(failed, Cancel())


def test_another_rollout_does_not_agree(failed):
    again = run_again(replace(failed, plan=replace(failed.plan, touches=("none",))))
    agreement = compare_rollouts(failed, again)
    assert not agreement.is_same


def test_damaged_rollouts_are_one_sentence(rollout_folder, tmp_path):
    copy = tmp_path / FAILS
    for spoil, word in (
        (lambda group: group.attrs.__setitem__("summary", "{"), "damaged"),
        (lambda group: group.attrs.__setitem__("plan", "[]"), "plan"),
        (lambda group: group.__delitem__("force"), "force"),
        (lambda group: group["time"].__setitem__(0, np.nan), "time"),
    ):
        shutil.copy(rollout_folder / FAILS, copy)
        with h5py.File(copy, "r+") as file:
            spoil(file["rollout"])
        with pytest.raises(FileProblem, match=word) as problem:
            read_rollout(copy)
        assert str(copy) in str(problem.value)


def test_a_damaged_file_is_a_row_with_its_problem(rollout_folder, tmp_path):
    shutil.copy(rollout_folder / FAILS, tmp_path / "good.h5")
    (tmp_path / "cut.h5").write_bytes((rollout_folder / FAILS).read_bytes()[:1000])
    cut, good = list_trials(tmp_path)
    assert (cut.outcome, good.outcome) == ("damaged", "fails")
    assert "cut.h5" in cut.problem
    (tmp_path / "good.h5").unlink()
    with pytest.raises(FileProblem, match="no rollout"):
        list_trials(tmp_path)
    assert is_rollout_folder(tmp_path)


def test_a_case_of_ones_own_lies_in_the_folder_of_its_rollouts(tmp_path):
    mesh = make_tool("spanner").mesh
    own = tmp_path / "own"
    folder = tmp_path / "rollouts"
    own.mkdir()
    folder.mkdir()
    (own / "mine.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices_mm)
        + "".join(f"f {a} {b} {c}\n" for a, b, c in mesh.triangles + 1)
    )
    (own / "mine.toml").write_text("mesh = 'mine.obj'\ndepth_mm = 6.0\n")
    copy_case(own / "mine.toml", folder)
    (job,) = make_jobs(
        str(own / "mine.toml"), touches=("none",), n_trials=1, tolerances_mm=(1.0,), folder=folder
    )
    run_job(job)
    shutil.rmtree(own)
    (row,) = list_trials(folder)
    rollout = read_rollout(row.path)
    assert rollout.plan.case == str(folder / "mine.toml")
    assert [body.name for body in build_scene(rollout).bodies] == [
        "hole",
        "left finger",
        "right finger",
    ]
    write_rollout_bundle(row.path, tmp_path / "mine.bundle")
    assert replay_rollout(tmp_path / "mine.bundle").agreement.is_same


def test_replay_finds_another_result(failed, tmp_path):
    copy = tmp_path / FAILS
    bundle = tmp_path / "b.bundle"
    shutil.copy(failed.path, copy)
    with h5py.File(copy, "r+") as file:
        plan = file["rollout"].attrs["plan"]
        file["rollout"].attrs["plan"] = plan.replace('"t2t"', '"none"')
    write_rollout_bundle(copy, bundle)
    assert not replay_rollout(bundle).agreement.is_same
    with pytest.raises(FileProblem, match="already"):
        write_rollout_bundle(copy, bundle)


def test_dashes_lie_on_the_edges_and_leave_gaps():
    box = make_box((3.0, 2.0, 1.0), "box")
    edges = find_edges(box)
    assert len(edges) == 12  # and no diagonal of a face
    dashes = cut_dashes(edges)
    lengths = np.linalg.norm(dashes[:, 1] - dashes[:, 0], axis=1).sum()
    assert lengths == pytest.approx(
        0.6 * np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum(), rel=1e-5
    )
    assert (np.abs(dashes.reshape(-1, 3)) <= (3.0, 2.0, 1.0)).all()


def test_angles_differ_by_at_most_half_a_turn(failed):
    decision = replace(
        failed.summary.decisions[0], estimate={"angle_deg": 179.0}, truth={"angle_deg": -179.0}
    )
    assert compute_error_deg(decision) == pytest.approx(2.0)
