"""Light that a dent takes from a pixel once: rendered here as it was seen on a real DIGIT, and read again."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from pipeline.evaluation.metrics import iou
from pipeline.geometry.rigid import translation
from pipeline.physics import optics
from pipeline.physics.slopes import slopes
from pipeline.sensors.spec import sensor
from pipeline.simulation import shapes, variation
from pipeline.simulation.press import press
from pipeline.stages.depth import cast_lamps, cast_light, gel_light, own_light
from pipeline.stages.depth.gel_light import Seen
from pipeline.stages.depth.stage import DepthParams, depth, draft, gel
from pipeline.values.frames import TactileFrame

PARAMS = DepthParams()
BALL_MM = 0.8
READ_MM = 0.04  # in the contact; the described light leaves 0.26
AZIMUTH_DEG, BRIGHTER = (9.0, -6.0, 7.0), 0.1  # of the unit's lamps, beside the described ones


@lru_cache
def ball():
    """A ball on a DIGIT whose lamps' light is lost once: (frame, truth, lamps)."""
    source, thing = sensor("digit"), shapes.shape("sphere").mesh
    felt = press(thing, translation(0.6, -0.8, -BALL_MM - thing.vertices_mm[:, 2].min()), source, seed=2)
    told = cast_light.described(source)
    lamps = replace(
        told, azimuth=told.azimuth + np.radians(AZIMUTH_DEG), share=told.share + BRIGHTER * (told.share > 0.3)
    )
    still = optics.untouched(source)
    rng = np.random.default_rng(0)
    drawn = still + seen_of(felt.truth.indentation_mm, still, source, lamps) + rng.normal(0.0, 1.0, still.shape)
    image = np.clip(np.rint(drawn), 0, 255).astype(np.uint8)
    return TactileFrame(sensor="digit", image=image, reference=still), felt.truth, lamps


def seen_of(indentation_mm, still, source, lamps):
    """The change of the picture (rows, cols, 3)."""
    rows, cols = still.shape[:2]
    whole = Seen(
        x_px=np.arange(cols, dtype=np.float32), y_px=np.arange(rows, dtype=np.float32),
        change=np.zeros(still.shape, np.float32), still=still.astype(np.float32),
        moved=np.ones((rows, cols), np.bool_), by=1, pixel_mm=source.pixel_mm, smoothing_px=0.0,
        bare=np.ones((rows, cols, 1), np.float32),
    )  # fmt: skip
    surface = np.array(indentation_mm)
    seen = cast_light.passed(lamps, surface, source.pixel_mm)
    return gel_light.recorded(
        cast_light.shown(lamps, whole, seen, *slopes(surface, source.pixel_mm)), source, whole
    )  # fmt: skip


def off_mm(found, truth):
    return float(np.abs(found.indentation_mm - truth.indentation_mm)[truth.contact].mean())


def test_a_ball_whose_lamps_lose_light_once_is_read():
    frame, truth, _ = ball()
    found, measured = gel(frame, sensor("digit"), None, PARAMS)
    assert isinstance(measured.light, cast_light.Lamps)
    assert any("that dents hide" in note for note in found.notes)
    assert off_mm(found, truth) < READ_MM
    assert iou(found.contact, truth.contact) > 0.8


def test_the_touch_tells_where_such_lamps_stand():
    frame, _, lamps = ball()
    _, measured = gel(frame, sensor("digit"), None, PARAMS)
    off = np.degrees(np.abs(measured.light.azimuth - lamps.azimuth))
    assert off.max() < 0.5 * max(map(abs, AZIMUTH_DEG))


def test_a_draft_is_read_by_such_lamps_too():
    frame, truth, _ = ball()
    depth(frame, sensor("digit"), None, PARAMS)
    found = depth(frame, sensor("digit"), None, draft(PARAMS))
    assert off_mm(found, truth) < 1.5 * READ_MM


@pytest.mark.parametrize("unit", [None, 4])
def test_a_touch_that_a_usual_units_lamps_explain_asks_for_no_others(unit, monkeypatch):
    source = sensor("digit") if unit is None else variation.varied(sensor("digit"), unit)
    thing = shapes.shape("star").mesh
    felt = press(thing, translation(0.3, -0.4, -0.6 - thing.vertices_mm[:, 2].min()), source, seed=2)
    frame = TactileFrame(sensor="digit", image=felt.image, reference=optics.untouched(source))
    monkeypatch.setattr(cast_lamps, "fitted", None)
    _, measured = gel(frame, sensor("digit"), None, PARAMS)
    assert own_light.explains(measured.light)


def test_lamps_that_explain_nothing_are_refused(monkeypatch):
    frame, _, _ = ball()
    monkeypatch.setattr(cast_lamps, "_LEFT", 1e-3)
    found, measured = gel(frame, sensor("digit"), None, PARAMS)
    assert measured.light == "even"
    monkeypatch.setattr(cast_lamps, "fitted", lambda *_: None)
    np.testing.assert_array_equal(gel(frame, sensor("digit"), None, PARAMS)[0].indentation_mm, found.indentation_mm)


def test_a_shadow_is_as_long_as_the_lamp_is_low():
    source = sensor("digit")
    surface = np.zeros(source.camera.shape, np.float32)
    surface[:, 60:80] = 0.5
    lamps = cast_light.Lamps(
        azimuth=np.array([0.0]), elevation=np.array([math.atan(0.5)]), share=np.full((3, 1), 0.5)
    )  # the light comes from the right
    seen = cast_light.passed(lamps, surface, source.pixel_mm)[0, 160]
    dark = np.flatnonzero(seen < 1.0)
    assert dark.max() == 59
    assert (60 - dark.min()) * source.pixel_mm == pytest.approx(1.0, abs=2 * source.pixel_mm)
    assert seen[80:].min() == 1.0
