"""Drafts: near the full answer, told as such, and called so all the way down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from app.session.sample import SAMPLE
from pipeline.engine.graph import Graph, Method
from pipeline.evaluation.metrics import iou
from pipeline.recordings import open_recording
from pipeline.sensors.parts import Optics
from pipeline.sensors.spec import sensor
from pipeline.stages.depth import coarse, gel_light, own_lamps, own_light, stage

TOUCHED = 5


@pytest.fixture(scope="module")
def frame():
    return open_recording(SAMPLE, sensor="gelslim").stream("gelslim").frame(TOUCHED)


def test_a_draft_of_a_gels_depth_is_near_the_full_answer_on_the_same_pixels(frame):
    gel = sensor("gelslim")
    whole = stage.recorded(frame, gel, None, stage.DepthParams())
    draft = stage.recorded(frame, gel, None, stage.draft(stage.DepthParams()))
    assert draft.indentation_mm.shape == whole.indentation_mm.shape == draft.contact.shape
    assert draft.camera == whole.camera
    assert iou(draft.contact, whole.contact) > 0.85
    assert draft.indentation_mm.max() == pytest.approx(whole.indentation_mm.max(), rel=0.1)
    np.testing.assert_allclose(draft.depth_mm, gel.rest_depth_mm - draft.indentation_mm, atol=1e-4)
    assert any("draft at 1/2 of the resolution" in note for note in draft.notes)
    assert not any("draft" in note for note in whole.notes)


def test_a_draft_looks_for_no_light_where_the_whole_answer_has_found_one(frame, monkeypatch):
    gel, looked, read = sensor("gelslim"), [], []
    fitted, read_by = own_lamps.fitted, own_light.read_by
    monkeypatch.setattr(own_lamps, "fitted", lambda *given: looked.append(1) or fitted(*given))
    monkeypatch.setattr(own_light, "read_by", lambda *given, **also: read.append(given[0]) or read_by(*given, **also))
    image = frame.image.copy()
    image[0, 0] ^= 1  # a picture that nobody has read
    unread = replace(frame, image=image)
    stage.depth(unread, gel, None, stage.draft(stage.DepthParams()))
    assert len(looked) == 1
    stage.depth(unread, gel, None, stage.DepthParams())
    looked.clear(), read.clear()
    stage.depth(unread, gel, None, stage.draft(stage.DepthParams(sensitivity=1.2)))
    assert looked == []
    assert read
    assert all(isinstance(light, Optics) for light in read)


def test_a_picture_that_is_read_can_be_stopped_at_every_round(frame):
    told = []

    class Told:
        def step(self, fraction, text):
            told.append(fraction)

    stage.depth(frame, sensor("gelslim"), None, stage.DepthParams(), Told())
    assert len(told) > gel_light.ROUNDS + 4
    assert told == sorted(told)


def test_a_small_picture_is_read_whole():
    assert coarse.fewer((160, 214)) == 1
    assert coarse.fewer((1280, 1708)) == 8


def test_a_smaller_picture_is_what_a_smaller_camera_would_have_taken(frame):
    gel = sensor("gelslim")
    small = coarse.frame(frame, gel.camera, 2)
    assert small.image.shape[:2] == small.camera.shape == (160, 213)
    assert small.camera.fx_px == pytest.approx(gel.camera.fx_px / 2, rel=0.01)
    assert float(small.image.mean()) == pytest.approx(float(frame.image.mean()), abs=1.0)


@dataclass(frozen=True)
class Params:
    draft: bool = False


def test_what_rests_on_a_draft_is_called_one_too():
    def made(slot, *reads):
        return Method(slot=slot, name="m", title=slot, run=lambda *_: slot, params=Params, reads=reads)

    graph = Graph((made("a"), made("b", "a"), made("c", "b"), made("d", "a")))
    results = graph.evaluate("abcd", {}, {"b": Params(draft=True)})
    assert {name: result.draft for name, result in results.items()} == {"a": False, "b": True, "c": True, "d": False}
    again = graph.evaluate("abcd", {}, {"b": replace(Params(), draft=False)})
    assert not any(result.draft for result in again.values())
