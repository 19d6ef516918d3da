"""The paper's tables, from touches to rows, and the command that prints them."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.base.errors import SettingProblem
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.evaluation import held_out, time_error_sweep, touch_features
from pipeline.evaluation.held_out import SENSORS, HeldOutOptions, load_or_simulate, select_sensors
from pipeline.evaluation.paper_tables import EvaluationRequest, evaluate_tables, parse_direction
from pipeline.evaluation.published_results import PAPER_DIRECTIONS, PAPER_ROWS, find_paper_row
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder of held-out touches of one object of each set, so that a table takes seconds."""
    return tmp_path_factory.mktemp("held_out")


@pytest.fixture
def few(monkeypatch):
    """One object a group in place of all."""
    names = shapes.list_shapes
    monkeypatch.setattr(held_out.datasets.shapes, "names", lambda group="": names(group)[:1] if group else names())


def wanted(kept, **more):
    small = HeldOutOptions(grasps=1, folder=kept)
    return EvaluationRequest(
        split="unseen_tools", held_out=small, directions=(("gelslim", "soft_bubble"),), pose_methods=(), **more
    )


def test_the_papers_rows_are_all_there():
    for rows in PAPER_ROWS.values():
        assert [(r.source, r.target) for r in rows if r.model == "T2D2"] == list(PAPER_DIRECTIONS)
        assert [r.target for r in rows if not r.source] == ["soft_bubble", "gelslim"]
    row = find_paper_row("unseen_tools", "soft_bubble", "gelslim", "T2T")
    assert row is not None
    assert (row.psnr_db, row.translation_mm) == (21.50, (2.53, 1.56))


def test_a_source_that_is_usually_not_asked_feels_the_touches_beside_both_targets():
    assert select_sensors("digit", "gelslim") == SENSORS
    assert select_sensors("gelsight_mini", "gelslim") == ("gelslim", "soft_bubble", "gelsight_mini")
    assert select_sensors("gelsight_mini", "soft_bubble") == select_sensors("gelsight_mini", "gelslim")


def test_sources_are_other_units_and_targets_the_described_one_of_the_same_presses(kept, few):
    from pipeline.recordings import open_recording

    (pressed,) = load_or_simulate("unseen_tools", HeldOutOptions(grasps=1, folder=kept))
    files = [open_recording(path) for path in (pressed.source, pressed.target)]
    truths = [file.stream("gelslim").truth(0) for file in files]
    frames = [file.stream("gelslim").frame(0) for file in files]
    assert np.array_equal(truths[0].sensor_from_object, truths[1].sensor_from_object)
    assert np.abs(frames[0].reference.astype(float) - frames[1].reference).mean() > 2.0
    before = pressed.target.stat().st_mtime_ns
    assert load_or_simulate("unseen_tools", HeldOutOptions(grasps=1, folder=kept)) == (pressed,)
    assert pressed.target.stat().st_mtime_ns == before  # it is kept, not made again


def test_a_row_for_each_baseline_and_method_and_physics_beats_the_baselines(kept, few):
    table = evaluate_tables(wanted(kept, contenders=("recorded", "untouched", "mean", "physics")))
    by = {row.candidate: row for row in table.rows}
    assert list(by) == ["recorded", "untouched", "mean", "physics"]
    assert not by["recorded"].metrics
    error = {name: by[name].metrics["error_mm"]["all"] for name in ("untouched", "mean", "physics")}
    assert error["physics"] < 0.7 * error["mean"] < error["untouched"]
    assert set(by["physics"].metrics["ssim"]) == {"all", "contact", "seen", "beyond"}
    assert by["physics"].metrics["correlation"]["all"] > 0.5
    assert "correlation" not in by["mean"].metrics
    assert by["physics"].ms > 0
    assert by["mean"].ms == 0
    assert any("real recordings" in note for note in table.notes)


def test_a_sensors_own_encoder_stays_while_its_pose_network_is_taught_on():
    bubble, gel = (touch_features.load_encoder_weights(load_sensor(name)) for name in ("soft_bubble", "gelslim"))
    assert (bubble.name, bubble.content_digest[:12]) == ("encoder_soft_bubble", "b665d91b6956"), (
        "older distances hold no more"
    )
    assert (gel.name, gel.content_digest[:12]) == ("encoder_gelslim", "26fb7c5802a9"), "older distances hold no more"


def test_guidance_is_swept_where_it_does_something_unless_steps_are_told(kept, monkeypatch):
    asked = []
    monkeypatch.setattr(time_error_sweep, "evaluated", lambda one, *_: asked.append(one.settings) or sweep_of_nothing())
    time_error_sweep.sweep_parameters(wanted(kept, contenders=("t2d2",)), ("guidance",))
    time_error_sweep.sweep_parameters(wanted(kept, contenders=("t2d2",), settings=("touch.steps=3",)), ("guidance",))
    steps = [dict(told.split("=") for told in settings).get("touch.steps") for settings in asked]
    n = len(time_error_sweep.SWEEP_VALUES["guidance"])
    assert steps == [None, *n * ["8"], *(1 + n) * ["3"]]


def sweep_of_nothing():
    return SimpleNamespace(rows=())


def test_a_sweep_asks_only_methods_that_have_the_parameter_and_draws_each_direction(kept, few, tmp_path):
    points = time_error_sweep.sweep_parameters(wanted(kept, contenders=("mean", "physics")), ("steps",))
    assert {(p.parameter, p.row.candidate) for p in points} == {("", "mean"), ("", "physics")}
    (picture,) = time_error_sweep.draw_sweep_plots(points, tmp_path)
    assert picture.name == "gelslim_to_soft_bubble.png"
    with pytest.raises(SettingProblem, match="not swept"):
        time_error_sweep.sweep_parameters(wanted(kept), ("seed",))


def test_the_command_prints_both_tables_and_writes_every_figure(kept, few, tmp_path, capsys):
    out = tmp_path / "table.json"
    code = run_app(build_app(), [
        "evaluate", "--split", "unseen_tools", "--grasps", "1", "--folder", str(kept), "--poses", "paper_2d",
        "--direction", "gelslim:soft_bubble", "--only", "recorded", "--only", "physics", "--json", str(out),
    ])  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "(0.42 ± 0.26)" in said.out  # the paper's own row of a bubble's touches
    told = json.loads(out.read_text())
    assert [row["contender"] for row in told["rows"]] == ["recorded", "physics"]
    assert told["rows"][0]["paper"]["turn_deg"] == [1.03, 0.90]
    assert told["rows"][1]["poses"]["paper_2d"]["answers"] == 1


@pytest.mark.parametrize(
    ("tokens", "said"),
    [
        (("--direction", "gelslim"), "source:target"),
        (("--only", "magic"), "no way to a touch is called 'magic'"),
        (("--set", "touch.wish=3"), "no touch method has a parameter 'wish'"),
        (("--grasps", "0"), "--grasps must lie within"),
    ],
)
def test_mistakes_are_one_sentence(tokens, said, capsys, kept, few):
    few_of = () if "--grasps" in tokens else ("--grasps", "1")
    code = run_app(build_app(), ["evaluate", "--split", "unseen_tools", "--folder", str(kept), *few_of, *tokens])
    assert code == EXIT_USER_ERROR
    assert said in capsys.readouterr().err


def test_directions_are_pairs_of_known_sensors():
    assert parse_direction("digit:gelslim") == ("digit", "gelslim")
    with pytest.raises(SettingProblem):
        parse_direction("digit:nothing")
