"""Truth in place of one slot after the other: the parts add up, and each takes what is its own."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.base.arrays import freeze
from pipeline.base.errors import SettingProblem
from pipeline.engine.graph import StageResult
from pipeline.translation.catalogue import default_params
from pipeline.translation.error_attribution import OUTSIDE_VIEW, attribute_error
from pipeline.translation.translate import Request, open_translation

TOUCHED = 5


@pytest.fixture(scope="module")
def to_bubble():
    """The sample's GelSlim turned into its bubble, with what keeps its values."""
    translation = open_translation(Request(recording=SAMPLE_RECORDING, source="gelslim", target="soft_bubble"))
    yield translation, translation.build_graph(), default_params(translation.methods)
    translation.recording.close()


def test_the_parts_and_the_rest_add_up(to_bubble):
    for figure in ("touch_depth.contact_mae_mm", "pose.mssd_mm"):
        found = attribute_error(*to_bubble, TOUCHED, figure)
        assert found.total == pytest.approx(sum(part.share for part in found.parts) + found.rest)
        assert found.parts[-1].left == found.rest


def test_true_values_in_every_slot_leave_no_error(to_bubble):
    found = attribute_error(*to_bubble, TOUCHED)
    assert found.rest == 0.0
    assert found.total > 0.1


def test_what_the_source_never_felt_is_named(to_bubble):
    """A bubble feels much more of the tool than the gel: depth and drawing have little to do with the error."""
    found = attribute_error(*to_bubble, TOUCHED)
    share = {part.title: part.share for part in found.parts}
    assert share[OUTSIDE_VIEW] > 0.8 * found.total
    assert OUTSIDE_VIEW in found.sentence


def test_a_spoilt_slot_takes_the_blame(to_bubble, monkeypatch):
    """Depth that is 1 mm too deep is found to be depth's doing, and no other slot's."""
    translation, graph, params = to_bubble
    clean = {
        part.title: part.share
        for part in attribute_error(translation, graph, params, TOUCHED, "touch_depth.mae_mm").shares
    }
    depth = next(method for method in translation.methods if method.slot == "depth")

    def deeper(*reads):
        made = depth.run(*reads)
        more = np.where(made.contact, made.indentation_mm + 1.0, made.indentation_mm).astype(np.float32)
        return replace(made, indentation_mm=freeze(more), depth_mm=freeze(made.depth_mm - 1.0 * made.contact))

    spoilt = tuple(replace(m, run=deeper, version=99) if m.slot == "depth" else m for m in translation.methods)
    found = attribute_error(translation, graph.with_methods(spoilt), params, TOUCHED, "touch_depth.mae_mm")
    shares = {part.title: part.share for part in found.shares}
    assert shares["depth"] > clean["depth"] + 0.002
    others = [title for title in shares if title != "depth"]
    assert all(shares[title] == pytest.approx(clean[title], abs=1e-9) for title in others)


def test_an_untouched_frame_and_a_recording_without_truth_have_nothing_to_blame(to_bubble):
    assert attribute_error(*to_bubble, 0) is None


@pytest.mark.parametrize(("figure", "told"), [("touch_depth.nonsense", "no figure"), ("nowhere.mae_mm", "no figure"),
                                              ("touch_depth.contact_iou", "no error")])  # fmt: skip
def test_a_figure_that_cannot_be_taken_apart_is_refused(to_bubble, figure, told):
    with pytest.raises(SettingProblem, match=told):
        attribute_error(*to_bubble, TOUCHED, figure)


def test_every_slot_but_the_cloud_knows_its_truth(to_bubble):
    translation = to_bubble[0]
    truths = translation.truths(TOUCHED)
    assert set(truths) == set(translation.slots) - {"cloud"}
    results = {
        name: StageResult(name=name, method=None, output=value, state="given", ms=0.0, notes=(), digest="")
        for name, value in truths.items()
    }
    metrics = translation.metrics(results, TOUCHED)
    for name in ("depth.mae_mm", "touch_depth.mae_mm", "touch.depth_mae_mm", "pose.translation_mm", "pose.mssd_mm"):
        assert metrics[name] == pytest.approx(0.0, abs=1e-9), name


def test_the_command_prints_the_worst_first_and_writes_every_part(capsys, tmp_path):
    from pipeline.cli.main import build_app, run_app

    out = tmp_path / "blame.json"
    assert run_app(build_app(), ["blame", str(SAMPLE_RECORDING), "--target", "gelslim", "--sensor", "digit", "--frame", "5",
                         "--json", str(out)]) == 0  # fmt: skip
    printed = capsys.readouterr().out
    assert "frame 5 is the worst" in printed
    (one,) = json.loads(out.read_text())
    assert one["total"] == pytest.approx(sum(part["share"] for part in one["parts"]) + one["rest"])


def test_the_command_says_where_no_truth_is_known(capsys):
    from pipeline.cli.main import build_app, run_app

    assert run_app(build_app(), ["blame", str(SAMPLE_RECORDING), "--target", "gelsight_mini", "--frame", "5"]) == 2
    assert "really felt" in capsys.readouterr().err
