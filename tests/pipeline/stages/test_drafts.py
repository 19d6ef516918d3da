"""Drafts: close to the full result, and marked as drafts in all that rests on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.base.progress import SILENT
from pipeline.calibration.calibration_table import make_built_in
from pipeline.engine.graph import Graph, Method
from pipeline.metrics.stage_metrics import iou
from pipeline.recordings import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import draft_resolution, gel_depth, photometric
from pipeline.stages.depth.illumination.constants import CONSTANTS
from pipeline.stages.depth.stage import PHYSICS

TOUCHED = 5


@pytest.fixture(scope="module")
def frame():
    return open_recording(SAMPLE_RECORDING, sensor="gelslim").stream("gelslim").frame(TOUCHED)


def test_a_draft_of_a_gel_is_close_to_the_full_result_on_the_same_pixels(frame):
    gel = load_sensor("gelslim")
    whole, draft = (
        PHYSICS.run(frame, gel, None, params, SILENT) for params in (PHYSICS.params(), PHYSICS.draft(PHYSICS.params()))
    )
    assert draft.indentation_mm.shape == whole.indentation_mm.shape == draft.contact.shape
    assert draft.camera == whole.camera
    assert iou(draft.contact, whole.contact) > 0.85
    inside = whole.contact
    assert draft.indentation_mm[inside].mean() == pytest.approx(whole.indentation_mm[inside].mean(), rel=0.06)
    np.testing.assert_allclose(draft.depth_mm, gel.rest_depth_mm - draft.indentation_mm, atol=1e-4)
    assert any("draft at 1/2 of the resolution" in note for note in draft.notes)
    assert not any("draft" in note for note in whole.notes)


@pytest.mark.parametrize("index", [3, 8, 9, 13])
def test_a_draft_keeps_touches_that_fill_the_view(index):
    stream, spec = open_recording(SAMPLE_RECORDING, sensor="digit").stream("digit"), load_sensor("digit")
    draft = photometric.estimate_depth(
        stream.frame(index), spec, None, photometric.make_draft_params(photometric.DepthParams())
    )
    whole = photometric.estimate_depth(stream.frame(index), spec, None, photometric.DepthParams())
    assert iou(draft.contact, whole.contact) > 0.8
    for untouched in (1, 2, 14):
        assert not photometric.estimate_depth(
            stream.frame(untouched), spec, None, photometric.make_draft_params(photometric.DepthParams())
        ).contact.any()


def test_a_draft_takes_the_illumination_of_the_full_frame(frame, monkeypatch):
    gel, used = load_sensor("gelslim"), []
    measure = gel_depth.measure_gel_depth

    def watch(frame, source, calibration, illumination, **settings):
        used.append(illumination)
        return measure(frame, source, calibration, illumination, **settings)

    monkeypatch.setattr(gel_depth, "measure_gel_depth", watch)
    for params in (photometric.make_draft_params(photometric.DepthParams(sensitivity=1.2)), photometric.DepthParams()):
        photometric.estimate_depth(frame, gel, None, params)
    assert used[0] == used[1] == photometric.estimate_illumination(frame, gel, None)
    assert used[0].model == "leds"


def test_a_frame_can_be_cancelled_at_every_iteration(frame):
    fractions = []

    class Recorder:
        def step(self, fraction, text):
            fractions.append(fraction)

    photometric.estimate_depth(frame, load_sensor("gelslim"), None, photometric.DepthParams(), Recorder())
    assert len(fractions) > CONSTANTS.iterations + 4
    assert fractions == sorted(fractions)


def test_a_small_image_is_not_downsampled():
    assert draft_resolution.compute_downsampling((160, 214)) == 1
    assert draft_resolution.compute_downsampling((1280, 1708)) == 8


def test_a_downsampled_frame_is_that_of_a_smaller_camera(frame):
    gel = load_sensor("gelslim")
    small = draft_resolution.downsample_frame(frame, gel.camera, 2)
    assert small.image.shape[:2] == small.camera.shape == (160, 213)
    assert small.camera.fx_px == pytest.approx(gel.camera.fx_px / 2, rel=0.01)
    assert float(small.image.mean()) == pytest.approx(float(frame.image.mean()), abs=1.0)


@dataclass(frozen=True)
class Params:
    draft: bool = False


def test_what_rests_on_a_draft_is_a_draft():
    def make_method(stage, *reads):
        return Method(stage=stage, name="m", title=stage, run=lambda *_: stage, params=Params, reads=reads)

    graph = Graph((make_method("a"), make_method("b", "a"), make_method("c", "b"), make_method("d", "a")))
    results = graph.evaluate("abcd", {}, {"b": Params(draft=True)})
    assert {name: result.draft for name, result in results.items()} == {"a": False, "b": True, "c": True, "d": False}
    again = graph.evaluate("abcd", {}, {"b": replace(Params(), draft=False)})
    assert not any(result.draft for result in again.values())


@pytest.mark.parametrize("by", [2, 3])
def test_a_downsampled_calibration_is_as_wide_in_millimetres(by):
    known = make_built_in(load_sensor("gelslim"))
    small = draft_resolution.downsample_calibration(known, by)
    assert small is not None
    assert (small.rows, small.cols) == (known.rows // by, known.cols // by)
    assert small.cols * small.pixel_mm == pytest.approx(known.cols * known.pixel_mm)
    assert draft_resolution.downsample_calibration(None, by) is None
