"""Low LEDs of which shading and shadow take the light once, rendered as on a real DIGIT and fitted again."""

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
from pipeline.stages.depth.illumination import selection, shadow_light
from pipeline.stages.depth.illumination.light import ImagePatch, simulate_recorded_change
from pipeline.stages.depth.photometric import DepthParams, estimate_gel_depth
from pipeline.values.frames import TactileFrame

PARAMS = DepthParams()
BALL_MM = 0.8  # indentation
MAX_ERROR_MM = 0.04  # mean in contact; the described light leaves 0.26
AZIMUTH_DEG, SHARE = (9.0, -6.0, 7.0), 0.1  # deviations of the instance's LEDs from the description


@lru_cache
def ball():
    """A ball on a DIGIT with shadow LEDs: (frame, truth, LEDs)."""
    source, mesh = load_sensor("digit"), shapes.make_shape("sphere").mesh
    press = simulate_press(mesh, translation(0.6, -0.8, -BALL_MM - mesh.vertices_mm[:, 2].min()), source, seed=2)
    described = shadow_light.make_described_leds(source)
    leds = replace(
        described,
        azimuth_rad=described.azimuth_rad + np.radians(AZIMUTH_DEG),
        colour_share=described.colour_share + SHARE * (described.colour_share > 0.3),
    )
    reference = optics.render_reference(source)
    noise = np.random.default_rng(0).normal(0.0, 1.0, reference.shape)
    light = reference + render_change(press.truth.indentation_mm, reference, source, leds) + noise
    image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    return TactileFrame(sensor="digit", image=image, reference=reference), press.truth, leds


def render_change(indentation_mm, reference, source, leds):
    """The recorded change (rows, cols, 3)."""
    rows, cols = reference.shape[:2]
    patch = ImagePatch(
        x_px=np.arange(cols, dtype=np.float32), y_px=np.arange(rows, dtype=np.float32),
        change=np.zeros(reference.shape, np.float32), reference=reference.astype(np.float32),
        changed=np.ones((rows, cols), np.bool_), downsampling=1, pixel_mm=source.pixel_mm, smoothing_px=0.0,
        unmarked_share=np.ones((rows, cols, 3), np.float32),
    )  # fmt: skip
    light, surface = shadow_light.make_shadow_light(source, leds, patch), np.array(indentation_mm)
    return simulate_recorded_change(
        light.render(surface, *compute_slopes(surface, source.pixel_mm)).change, patch, light.blur_px
    )


def mean_error_mm(depth, truth):
    return float(np.abs(depth.indentation_mm - truth.indentation_mm)[truth.contact].mean())


def test_a_ball_is_measured_with_shadow_leds():
    frame, truth, _ = ball()
    depth, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    assert measured.model == "shadow_leds"
    assert any("low LEDs" in note for note in depth.notes)
    assert mean_error_mm(depth, truth) < MAX_ERROR_MM
    assert iou(depth.contact, truth.contact) > 0.8


def test_the_fit_recovers_the_azimuths_of_the_leds():
    frame, _, leds = ball()
    source = load_sensor("digit")
    _, measured = estimate_gel_depth(frame, source, None, PARAMS)
    described = shadow_light.make_described_leds(source)
    fitted = shadow_light.shift_leds(described, np.array(measured.parameters))
    off = np.degrees(np.abs(fitted.azimuth_rad - leds.azimuth_rad))
    assert off.max() < 0.5 * max(map(abs, AZIMUTH_DEG))


@pytest.mark.parametrize("seed", [None, 4])
def test_no_shadow_leds_are_fitted_where_usual_leds_explain_the_image(seed, monkeypatch):
    source = load_sensor("digit") if seed is None else variation.vary_sensor(load_sensor("digit"), seed)
    mesh = shapes.make_shape("star").mesh
    press = simulate_press(mesh, translation(0.3, -0.4, -0.6 - mesh.vertices_mm[:, 2].min()), source, seed=2)
    frame = TactileFrame(sensor="digit", image=press.image, reference=optics.render_reference(source))
    monkeypatch.setattr(selection, "fit_shadow_leds", None)
    _, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    assert measured.is_trusted


def test_the_described_light_stands_where_shadow_leds_are_rejected(monkeypatch):
    frame, _, _ = ball()
    monkeypatch.setattr(selection, "fit_shadow_leds", lambda *_: None)
    _, measured = estimate_gel_depth(frame, load_sensor("digit"), None, PARAMS)
    assert measured == selection.DESCRIBED


def test_a_shadow_is_as_long_as_the_led_is_low():
    source = load_sensor("digit")
    surface = np.zeros(source.camera.shape, np.float32)
    surface[:, 60:80] = 0.5
    leds = shadow_light.LedArray(
        azimuth_rad=np.array([0.0]), elevation_rad=np.array([math.atan(0.5)]), colour_share=np.full((3, 1), 0.5)
    )  # the light comes from the right
    visible = shadow_light.compute_visibility(leds, surface, source.pixel_mm)[0, 160]
    dark = np.flatnonzero(visible < 1.0)
    assert dark.max() == 59
    assert (60 - dark.min()) * source.pixel_mm == pytest.approx(1.0, abs=2 * source.pixel_mm)
    assert visible[80:].min() == 1.0
