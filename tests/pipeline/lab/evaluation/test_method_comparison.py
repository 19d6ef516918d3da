"""One frame's touch by every method: metrics against the recorded touch, with a shared cache."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.progress import Cancelled
from pipeline.lab.evaluation.method_comparison import compare_methods, sort_tiles
from pipeline.lab.evaluation.variants import VariantRunner, list_method_variants
from pipeline.stages.networks import weights_registry
from pipeline.translation.translate import Request, open_translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Tile

SAMPLE = Path(__file__).parents[4] / "sample_data" / "recordings" / "first_touch.h5"
FRAME = 5


@pytest.fixture
def no_weights(tmp_path, monkeypatch):
    """No shipped weights, so that no torch is loaded."""
    monkeypatch.setattr(weights_registry, "WEIGHTS_FOLDER", tmp_path)


@pytest.fixture
def opened():
    with closing(
        open_translation(Request(recording=SAMPLE, source="gelslim", target="soft_bubble"))
    ) as translation:
        yield translation


def physics_result(runner, opened, **params):
    """The result of physics."""
    ((variant, *_), _) = list_method_variants(opened, params, "touch")
    (result,) = runner.evaluate_all([variant], FRAME, ["touch"])
    return result


def test_methods_without_weights_are_named_and_left_out(opened, no_weights):
    variants, excluded = list_method_variants(opened, {}, "touch")
    assert [dict(v.translation.request.methods)["touch"] for v in variants] == ["physics", "object"]
    assert len(excluded) == len(opened.catalogue.stage("touch").methods) - 2


def test_a_touch_is_compared_in_contact_and_overall_with_the_recorded_one(opened, no_weights):
    runner = VariantRunner()
    *_, comparison = compare_methods(runner, opened, FRAME, {}, DisplayParams(), "in order")
    truth, tile, by_object = comparison.tiles
    assert by_object.metrics["contact_error_mm"] < 0.8 * tile.metrics["contact_error_mm"]
    assert truth.title == "truth"
    recorded = opened.read_target_observation(FRAME)[0]
    # as Demo shows it, with the camera's noise
    assert np.array_equal(truth.preview.distance_mm, recorded.image)
    target = opened.read_ground_truth(FRAME).target_truth
    membrane = physics_result(runner, opened).results["touch"].output.membrane
    error = abs(membrane.indentation_mm.astype(float) - target.indentation_mm)
    assert tile.metrics["contact_error_mm"] == pytest.approx(error[target.contact].mean(), rel=0.05)
    assert tile.metrics["error_mm"] < tile.metrics["contact_error_mm"]
    assert 20.0 < tile.metrics["psnr_db"] < 60.0
    assert 0.0 < tile.metrics["ssim"] <= 1.0


def test_results_are_shared_and_their_times_are_remembered(opened, no_weights):
    runner = VariantRunner()
    first = physics_result(runner, opened)
    again = physics_result(runner, opened)
    assert again.results["touch"].output is first.results["touch"].output
    assert again.ms == pytest.approx(first.ms)
    physics = opened.catalogue.method("touch", "physics").params()
    other = physics_result(
        runner, opened, **{"touch/physics": replace(physics, contact_gap_mm=1.0)}
    )
    assert other.results["touch"].output is not first.results["touch"].output
    assert other.ms > 0.5 * first.ms  # as if the stages before it had been computed too


def test_a_comparison_can_be_cancelled(opened):
    class Stopped:
        def step(self, fraction: float, text: str) -> None:
            raise Cancelled

    with pytest.raises(Cancelled):
        list(
            compare_methods(
                VariantRunner(), opened, FRAME, {}, DisplayParams(), "in order", Stopped()
            )
        )


def test_a_recording_of_one_sensor_gives_no_metrics(opened, no_weights):
    alone = replace(
        opened, recording=replace(opened.recording, streams=(opened.stream,)), mesh=None
    )
    *_, comparison = compare_methods(VariantRunner(), alone, FRAME, {}, DisplayParams(), "in order")
    (tile,) = comparison.tiles
    assert "Object: physics: no object mesh" in comparison.summary
    assert tile.preview is not None
    assert not tile.metrics


def test_tiles_without_error_come_last_in_any_order():
    tiles = [
        Tile(title=name, metrics=metrics)
        for name, metrics in (
            ("a", {"contact_error_mm": 1.0}),
            ("b", {}),
            ("c", {"contact_error_mm": 3.0}),
            ("d", {"error_mm": 2.0}),
        )
    ]
    for order, titles in (("worst first", "cdab"), ("best first", "adcb"), ("in order", "abcd")):
        assert "".join(tile.title for tile in sort_tiles(tiles, order)) == titles


def test_a_method_that_cannot_run_has_no_tile_and_is_named_with_its_reason(
    opened, no_weights, monkeypatch
):
    runner = VariantRunner()
    failed = replace(
        physics_result(runner, opened), problem="this sensor is unknown to it; train another"
    )
    monkeypatch.setattr(runner, "evaluate_all", lambda *_: iter([failed]))
    *_, comparison = compare_methods(runner, opened, FRAME, {}, DisplayParams(), "in order")
    assert [tile.title for tile in comparison.tiles] == ["truth"]
    assert f"{failed.variant.label}: this sensor is unknown to it" in comparison.summary
