"""The paper's tables, from touches to rows, and the command that prints them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.errors import SettingProblem
from pipeline.lab.evaluation import held_out, touch_scoring
from pipeline.lab.evaluation.held_out import (
    SENSORS,
    HeldOutOptions,
    load_or_simulate,
    select_sensors,
)
from pipeline.lab.evaluation.paper_tables import EvaluationRequest, evaluate_tables, parse_direction
from pipeline.lab.evaluation.published_results import PAPER_DIRECTIONS, PAPER_ROWS, find_paper_row
from pipeline.physics.simulation import shapes
from pipeline.sensors.spec import load_sensor


@pytest.fixture(scope="module")
def cache_folder(tmp_path_factory):
    """Folder of the held-out touches of one object per split, so that a table takes seconds."""
    return tmp_path_factory.mktemp("held_out")


@pytest.fixture
def few_objects(monkeypatch):
    """One object per group instead of all."""
    names = shapes.list_shapes
    monkeypatch.setattr(
        held_out.datasets.shapes,
        "list_shapes",
        lambda group="": names(group)[:1] if group else names(),
    )


def build_request(cache_folder, **more):
    small = HeldOutOptions(grasps=1, folder=cache_folder)
    return EvaluationRequest(
        split="unseen_tools",
        held_out=small,
        directions=(("gelslim", "soft_bubble"),),
        pose_methods=(),
        **more,
    )


def test_the_papers_rows_are_all_there():
    for rows in PAPER_ROWS.values():
        assert [(r.source, r.target) for r in rows if r.model == "T2D2"] == list(PAPER_DIRECTIONS)
        assert [r.target for r in rows if not r.source] == ["soft_bubble", "gelslim"]
    row = find_paper_row("unseen_tools", "soft_bubble", "gelslim", "T2T")
    assert row is not None
    assert (row.psnr_db, row.translation_mm) == (21.50, (2.53, 1.56))


def test_another_source_records_the_touches_with_both_targets():
    assert select_sensors("digit", "gelslim") == SENSORS
    assert select_sensors("gelsight_mini", "gelslim") == ("gelslim", "soft_bubble", "gelsight_mini")
    assert select_sensors("gelsight_mini", "soft_bubble") == select_sensors(
        "gelsight_mini", "gelslim"
    )


def test_the_sources_own_depth_is_a_row_of_poses_and_the_object_one_of_touches(
    cache_folder, few_objects
):
    request = replace(
        build_request(cache_folder, candidates=("own", "object", "physics")),
        pose_methods=("signed_distances", "network"),
    )
    own, physics, by_object = evaluate_tables(request).rows
    assert [row.candidate for row in (own, physics, by_object)] == ["own", "physics", "object"]
    assert not own.metrics
    assert own.pose_errors["signed_distances"].n_poses == own.n_touches
    errors = own.pose_errors["signed_distances"]
    assert errors.rotation_deg[0] < 2.0
    assert errors.translation_mm[0] < 0.2, "at the contact, which lies in the target's frame too"
    assert own.pose_errors["network"].translation_mm[0] < 3.0, "by the network of the source"
    assert by_object.metrics["error_mm"]["contact"] < physics.metrics["error_mm"]["contact"]


def test_another_seed_gives_other_touches(cache_folder, few_objects):
    first, other = (
        load_or_simulate("unseen_tools", HeldOutOptions(grasps=1, seed=seed, folder=cache_folder))
        for seed in (0, 1)
    )
    assert first[0].source != other[0].source


def test_sources_are_varied_instances_and_targets_the_described_one_of_the_same_presses(
    cache_folder, few_objects
):
    from pipeline.io import open_recording

    (pressed,) = load_or_simulate("unseen_tools", HeldOutOptions(grasps=1, folder=cache_folder))
    files = [open_recording(path) for path in (pressed.source, pressed.target)]
    truths = [file.stream("gelslim").truth(0) for file in files]
    frames = [file.stream("gelslim").frame(0) for file in files]
    assert np.array_equal(truths[0].sensor_from_object, truths[1].sensor_from_object)
    assert np.abs(frames[0].reference.astype(float) - frames[1].reference).mean() > 2.0
    before = pressed.target.stat().st_mtime_ns
    assert load_or_simulate("unseen_tools", HeldOutOptions(grasps=1, folder=cache_folder)) == (
        pressed,
    )
    assert pressed.target.stat().st_mtime_ns == before  # cached, not simulated again


def test_a_row_for_each_baseline_and_method_and_physics_beats_the_baselines(
    cache_folder, few_objects
):
    table = evaluate_tables(
        build_request(cache_folder, candidates=("recorded", "no_contact", "mean", "physics"))
    )
    by = {row.candidate: row for row in table.rows}
    assert list(by) == ["recorded", "no_contact", "mean", "physics"]
    assert not by["recorded"].metrics
    error = {
        name: by[name].metrics["error_mm"]["all"] for name in ("no_contact", "mean", "physics")
    }
    assert error["physics"] < 0.7 * error["mean"] < error["no_contact"]
    assert set(by["physics"].metrics["ssim"]) == {"all", "contact", "visible", "outside"}
    assert by["physics"].metrics["correlation"]["all"] > 0.5
    assert "correlation" not in by["mean"].metrics
    assert by["physics"].ms > 0
    assert by["mean"].ms == 0
    assert any("real recordings" in note for note in table.notes)


def test_the_encoders_of_the_feature_distances_do_not_change():
    bubble, gel = (
        touch_scoring.load_encoder_weights(load_sensor(name)) for name in ("soft_bubble", "gelslim")
    )
    assert (bubble.name, bubble.content_digest[:12]) == ("encoder_soft_bubble", "29fb460ca3ef"), (
        "distances of earlier reports are not comparable"
    )
    assert (gel.name, gel.content_digest[:12]) == ("encoder_gelslim", "8b3593db1308"), (
        "distances of earlier reports are not comparable"
    )


def test_the_command_prints_both_tables_and_writes_every_metric(
    cache_folder, few_objects, tmp_path, capsys
):
    out = tmp_path / "table.json"
    code = run_app(
        build_app(),
        [
            "evaluate",
            "--split",
            "unseen_tools",
            "--grasps",
            "1",
            "--folder",
            str(cache_folder),
            "--poses",
            "paper_2d",
            "--direction",
            "gelslim:soft_bubble",
            "--only",
            "recorded",
            "--only",
            "physics",
            "--json",
            str(out),
        ],
    )
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "(0.42 ± 0.26)" in said.out  # the paper's row of a bubble's recorded touches
    table = json.loads(out.read_text())
    assert [row["candidate"] for row in table["rows"]] == ["recorded", "physics"]
    assert table["rows"][0]["paper"]["rotation_deg"] == [1.03, 0.90]
    assert table["rows"][1]["pose_errors"]["paper_2d"]["n_poses"] == 1


@pytest.mark.parametrize(
    ("tokens", "said"),
    [
        (("--direction", "gelslim"), "source:target"),
        (("--only", "magic"), "'magic'"),
        (("--method", "touch=physics"), "name those of interest with --only"),
        (("--set", "touch.wish=3"), "'wish'"),
        (("--grasps", "0"), "--grasps must lie within"),
        (("--inception", __file__), "--inception: "),
    ],
)
def test_mistakes_are_one_sentence(tokens, said, capsys, cache_folder, few_objects):
    grasps = () if "--grasps" in tokens else ("--grasps", "1")
    code = run_app(
        build_app(),
        ["evaluate", "--split", "unseen_tools", "--folder", str(cache_folder), *grasps, *tokens],
    )
    assert code == EXIT_USER_ERROR
    assert said in capsys.readouterr().err


def test_directions_are_pairs_of_known_sensors():
    assert parse_direction("digit:gelslim") == ("digit", "gelslim")
    with pytest.raises(SettingProblem):
        parse_direction("digit:nothing")
    with pytest.raises(SettingProblem, match="between two sensors"):
        parse_direction("digit:digit")
