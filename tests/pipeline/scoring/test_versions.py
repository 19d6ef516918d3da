"""One frame's touch by every method: judged by what was recorded, sharing what does not depend on the method."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.base.progress import Cancelled
from pipeline.evaluation.method_results import MethodCache, evaluate_methods, list_available_methods
from pipeline.networks import weights_registry
from pipeline.translation.translate import Request, open_translation

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
FRAME = 5


@pytest.fixture
def without_shipped(tmp_path, monkeypatch):
    """No weights are shipped, so that no torch is loaded."""
    monkeypatch.setattr(weights_registry, "WEIGHTS_FOLDER", tmp_path)


@pytest.fixture
def opened():
    with closing(open_translation(Request(recording=SAMPLE, source="gelslim", target="soft_bubble"))) as translation:
        yield translation


def test_those_without_weights_are_named_and_not_tried(opened, without_shipped):
    found = list_available_methods(opened)
    assert [method.name for method, _ in found.translations] == ["physics"]
    assert len(found.excluded) == len(opened.catalogue.slot("touch").methods) - 1
    assert all("shipped" in why for why in found.excluded)


def test_a_touch_is_judged_in_contact_and_over_all_by_what_was_recorded(opened, without_shipped):
    (version,) = evaluate_methods(opened, FRAME, {}, MethodCache())
    truth = opened.facts(FRAME).target
    off = abs(version.touch.membrane.indentation_mm.astype(float) - truth.indentation_mm)
    assert version.contact_error_mm == pytest.approx(off[truth.contact].mean(), rel=0.05)
    assert version.error_mm < version.contact_error_mm
    assert 20.0 < version.psnr_db < 60.0
    assert 0.0 < version.ssim <= 1.0
    assert version.ms > 1.0


def test_what_was_worked_out_is_shared_and_its_time_is_not_forgotten(opened, without_shipped):
    kept = MethodCache()
    (first,) = evaluate_methods(opened, FRAME, {}, kept)
    (again,) = evaluate_methods(opened, FRAME, {}, kept)
    assert again.touch is first.touch
    assert again.ms == pytest.approx(first.ms)
    (other,) = evaluate_methods(opened, FRAME, {"touch/physics": replace(_physics(opened), contact_gap_mm=1.0)}, kept)
    assert other.touch is not first.touch
    assert other.ms > 0.5 * first.ms  # as if the slots before it had been worked out too


def test_it_stops_when_nobody_wants_it(opened):
    class Stopped:
        def step(self, fraction: float, text: str) -> None:
            raise Cancelled

    with pytest.raises(Cancelled):
        list(evaluate_methods(opened, FRAME, {}, MethodCache(), Stopped()))


def test_a_recording_of_one_sensor_knows_no_error(opened, without_shipped):
    alone = replace(opened, recording=replace(opened.recording, streams=(opened.stream,)))
    (version,) = evaluate_methods(alone, FRAME, {}, MethodCache())
    assert version.touch is not None
    assert all(math.isnan(v) for v in (version.error_mm, version.contact_error_mm, version.psnr_db, version.ssim))


def _physics(opened):
    return opened.catalogue.method("touch", "physics").params()
