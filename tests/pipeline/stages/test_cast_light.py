"""Light that a dent takes from a pixel once: rendered here as it was seen on a real DIGIT, and read again."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from pipeline.geometry.rigid import translation
from pipeline.metrics.stage_metrics import iou
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes, variation
from pipeline.simulation.press import simulate_press
from pipeline.stages.depth import adaptive_illumination, shadow_led_calibration, shadow_model, surface_refinement
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, estimate_gel_depth, make_draft_params
from pipeline.stages.depth.surface_refinement import ImagePatch
from pipeline.values.frames import TactileFrame

PARAMS = DepthParams()
BALL_MM = 0.8
READ_MM = 0.04  # in the contact; the described light leaves 0.26
AZIMUTH_DEG, BRIGHTER = (9.0, -6.0, 7.0), 0.1  # of the unit's lamps, beside the described ones


@lru_cache
def ball():
    """A ball on a DIGIT whose lamps' light is lost once: (frame, truth, lamps)."""
    source, thing = load_sensor("digit"), shapes.make_shape("sphere").mesh
    felt = simulate_press(thing, translation(0.6, -0.8, -BALL_MM - thing.vertices_mm[:, 2].min()), source, seed=2)
    told = shadow_model.make_described_leds(source)
    lamps = replace(
        told,
        azimuth_rad=told.azimuth_rad + np.radians(AZIMUTH_DEG),
        colour_share=told.colour_share + BRIGHTER * (told.colour_share > 0.3),
    )
    still = optics.render_reference(source)
    rng = np.random.default_rng(0)
    drawn = still + seen_of(felt.truth.indentation_mm, still, source, lamps) + rng.normal(0.0, 1.0, still.shape)
    image = np.clip(np.rint(drawn), 0, 255).astype(np.uint8)
    return TactileFrame(sensor="digit", image=image, reference=still), felt.truth, lamps


def seen_of(indentation_mm, still, source, lamps):
    """The change of the picture (rows, cols, 3)."""
    rows, cols = still.shape[:2]
    whole = ImagePatch(
        x_px=np.arange(cols, dtype=np.float32), y_px=np.arange(rows, dtype=np.float32),
        change=np.zeros(still.shape, np.float32), reference=still.astype(np.float32),
        changed=np.ones((rows, cols), np.bool_), downsampling=1, pixel_mm=source.pixel_mm, smoothing_px=0.0,
        unmarked_share=np.ones((rows, cols, 1), np.float32),
    )  # fmt: skip
    surface = np.array(indentation_mm)
    seen = shadow_model.compute_visibility(lamps, surface, source.pixel_mm)
    return surface_refinement.simulate_recorded_change(
        shadow_model.render_change(lamps, whole, seen, *compute_slopes(surface, source.pixel_mm)), source, whole
    )  # fmt: skip


def off_mm(found, truth):
    return float(np.abs(found.indentation_mm - truth.indentation_mm)[truth.contact].mean())


def test_a_ball_whose_lamps_lose_light_once_is_read():
    frame, truth, _ = ball()
    found, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    assert isinstance(measured.light, shadow_model.LedArray)
    assert any("that dents hide" in note for note in found.notes)
    assert off_mm(found, truth) < READ_MM
    assert iou(found.contact, truth.contact) > 0.8


def test_the_touch_tells_where_such_lamps_stand():
    frame, _, lamps = ball()
    _, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    off = np.degrees(np.abs(measured.light.azimuth_rad - lamps.azimuth_rad))
    assert off.max() < 0.5 * max(map(abs, AZIMUTH_DEG))


def test_a_draft_is_read_by_such_lamps_too():
    frame, truth, _ = ball()
    estimate_depth(frame, load_sensor("digit"), None, PARAMS)
    found = estimate_depth(frame, load_sensor("digit"), None, make_draft_params(PARAMS))
    assert off_mm(found, truth) < 1.5 * READ_MM


@pytest.mark.parametrize("unit", [None, 4])
def test_a_touch_that_a_usual_units_lamps_explain_asks_for_no_others(unit, monkeypatch):
    source = load_sensor("digit") if unit is None else variation.vary_sensor(load_sensor("digit"), unit)
    thing = shapes.make_shape("star").mesh
    felt = simulate_press(thing, translation(0.3, -0.4, -0.6 - thing.vertices_mm[:, 2].min()), source, seed=2)
    frame = TactileFrame(sensor="digit", image=felt.image, reference=optics.render_reference(source))
    monkeypatch.setattr(shadow_led_calibration, "fit_shadow_leds", None)
    _, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    assert adaptive_illumination.is_trusted(measured.light)


def test_lamps_that_explain_nothing_are_refused(monkeypatch):
    frame, _, _ = ball()
    monkeypatch.setattr(shadow_led_calibration, "_LEFT", 1e-3)
    found, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    assert measured.light == "even"
    monkeypatch.setattr(shadow_led_calibration, "fit_shadow_leds", lambda *_: None)
    np.testing.assert_array_equal(
        estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)[0].indentation_mm, found.indentation_mm
    )


def test_a_shadow_is_as_long_as_the_lamp_is_low():
    source = load_sensor("digit")
    surface = np.zeros(source.camera.shape, np.float32)
    surface[:, 60:80] = 0.5
    lamps = shadow_model.LedArray(
        azimuth_rad=np.array([0.0]), elevation_rad=np.array([math.atan(0.5)]), colour_share=np.full((3, 1), 0.5)
    )  # the light comes from the right
    seen = shadow_model.compute_visibility(lamps, surface, source.pixel_mm)[0, 160]
    dark = np.flatnonzero(seen < 1.0)
    assert dark.max() == 59
    assert (60 - dark.min()) * source.pixel_mm == pytest.approx(1.0, abs=2 * source.pixel_mm)
    assert seen[80:].min() == 1.0
