"""Drafts: near the full answer, told as such, and called so all the way down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.base.progress import SILENT
from pipeline.engine.graph import Graph, Method
from pipeline.metrics.stage_metrics import iou
from pipeline.recordings import open_recording
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import (
    adaptive_illumination,
    draft_resolution,
    led_calibration,
    photometric,
    surface_refinement,
)
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.stages.depth.stage import NETWORK, PHYSICS

TOUCHED = 5


@pytest.fixture(scope="module")
def frame():
    return open_recording(SAMPLE_RECORDING, sensor="gelslim").stream("gelslim").frame(TOUCHED)


def read(method, frame, params, name="gelslim"):
    gel = load_sensor(name)
    weights = () if method.weights is None else (method.weights(gel, gel, None),)
    return method.run(frame, gel, None, *weights, params, SILENT)


@pytest.mark.parametrize("method", [NETWORK, PHYSICS], ids=lambda method: method.name)
def test_a_draft_of_a_gels_depth_is_near_the_full_answer_on_the_same_pixels(frame, method):
    gel = load_sensor("gelslim")
    whole, draft = (read(method, frame, params) for params in (method.params(), method.draft(method.params())))
    assert draft.indentation_mm.shape == whole.indentation_mm.shape == draft.contact.shape
    assert draft.camera == whole.camera
    assert iou(draft.contact, whole.contact) > 0.85
    inside = whole.contact
    assert draft.indentation_mm[inside].mean() == pytest.approx(whole.indentation_mm[inside].mean(), rel=0.06)
    np.testing.assert_allclose(draft.depth_mm, gel.rest_depth_mm - draft.indentation_mm, atol=1e-4)
    assert any("draft at 1/2 of the resolution" in note for note in draft.notes)
    assert not any("draft" in note for note in whole.notes)
    if method is NETWORK:
        assert draft.expected_error_mm.shape == whole.expected_error_mm.shape == gel.camera.shape


@pytest.mark.parametrize("index", [3, 8, 9, 13])
def test_a_draft_loses_no_touch_that_fills_the_view(index):
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


def test_settings_of_physics_count_where_the_network_corrects_it(frame):
    whole, faint = (read(NETWORK, frame, NetworkParams(contact_limit=limit)) for limit in (1.0, 8.0))
    assert 0 < faint.contact.sum() < whole.contact.sum()


def test_a_draft_looks_for_no_light_where_the_whole_answer_has_found_one(frame, monkeypatch):
    gel, looked, lit = load_sensor("gelslim"), [], []
    fitted, read_by = led_calibration.fit_leds, adaptive_illumination.refine_in_light
    monkeypatch.setattr(led_calibration, "fit_leds", lambda *given: looked.append(1) or fitted(*given))
    monkeypatch.setattr(
        adaptive_illumination, "refine_in_light", lambda *given, **also: lit.append(given[0]) or read_by(*given, **also)
    )
    image = frame.image.copy()
    image[0, 0] ^= 1  # a picture that nobody has read
    unread = replace(frame, image=image)
    photometric.estimate_depth(unread, gel, None, photometric.make_draft_params(photometric.DepthParams()))
    assert len(looked) == 1
    photometric.estimate_depth(unread, gel, None, photometric.DepthParams())
    looked.clear(), lit.clear()
    photometric.estimate_depth(
        unread, gel, None, photometric.make_draft_params(photometric.DepthParams(sensitivity=1.2))
    )
    assert looked == []
    assert lit
    assert all(isinstance(light, Optics) for light in lit)


def test_a_picture_that_is_read_can_be_stopped_at_every_round(frame):
    told = []

    class Told:
        def step(self, fraction, text):
            told.append(fraction)

    photometric.estimate_depth(frame, load_sensor("gelslim"), None, photometric.DepthParams(), Told())
    assert len(told) > surface_refinement.MAX_ITERATIONS + 4
    assert told == sorted(told)


def test_a_small_picture_is_read_whole():
    assert draft_resolution.compute_downsampling((160, 214)) == 1
    assert draft_resolution.compute_downsampling((1280, 1708)) == 8


def test_a_smaller_picture_is_what_a_smaller_camera_would_have_taken(frame):
    gel = load_sensor("gelslim")
    small = draft_resolution.downsample_frame(frame, gel.camera, 2)
    assert small.image.shape[:2] == small.camera.shape == (160, 213)
    assert small.camera.fx_px == pytest.approx(gel.camera.fx_px / 2, rel=0.01)
    assert float(small.image.mean()) == pytest.approx(float(frame.image.mean()), abs=1.0)


@dataclass(frozen=True)
class Params:
    draft: bool = False


def test_what_rests_on_a_draft_is_called_one_too():
    def made(slot, *reads):
        return Method(stage=slot, name="m", title=slot, run=lambda *_: slot, params=Params, reads=reads)

    graph = Graph((made("a"), made("b", "a"), made("c", "b"), made("d", "a")))
    results = graph.evaluate("abcd", {}, {"b": Params(draft=True)})
    assert {name: result.draft for name, result in results.items()} == {"a": False, "b": True, "c": True, "d": False}
    again = graph.evaluate("abcd", {}, {"b": replace(Params(), draft=False)})
    assert not any(result.draft for result in again.values())
