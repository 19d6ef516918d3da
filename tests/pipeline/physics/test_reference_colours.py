"""Whether a reference image is one of the described sensor."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.physics.optics import render_reference
from pipeline.physics.reference_colours import compare_colours
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor

SENSORS = ("gelslim", "gelsight_mini", "digit")
ROWS = 240
COLS = 320


def make_foreign_references():
    """Reference images (240, 320, 3) of sensors that no description fits: (name, image)."""
    down, right = np.meshgrid(
        np.linspace(-0.75, 0.75, ROWS), np.linspace(-1, 1, COLS), indexing="ij"
    )
    bright = 1 - 0.35 * (right**2 + down**2)
    yield "depth in grey", (160 * bright, 160 * bright, 160 * bright)
    yield "wedge lit from left and right", (120 - 90 * right, 60 * bright, 120 + 90 * right)
    yield "wedge lit from one side", (140 - 60 * right, 140 - 60 * right, 120 - 60 * right)
    yield "green gel", (60 * bright, 170 * bright, 80 * bright)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize(
    "channels", [pytest.param(c, id=name) for name, c in make_foreign_references()]
)
def test_references_of_an_unknown_sensor_are_named(sensor, channels):
    spec = load_sensor(sensor)
    rows, cols = spec.camera.shape
    noise = np.random.default_rng(0).normal(0, 1.5, (ROWS, COLS, 3))
    image = np.clip(np.stack(channels, axis=-1) + noise, 0, 255).astype(np.uint8)
    sized = np.asarray(cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA), np.uint8)
    assert compare_colours(sized, spec).problem


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("seed", range(4))
def test_references_of_usual_instances_are_accepted(sensor, seed):
    spec = load_sensor(sensor)
    assert not compare_colours(render_reference(vary_sensor(spec, seed, 1.0)), spec).problem


@pytest.mark.real_data
@pytest.mark.parametrize("clip", ["finray_left", "finray_right", "hex_key_left", "hex_key_right"])
def test_references_of_real_gelslim_clips_are_accepted(real_data, clip):
    spec = load_sensor("gelslim")
    panel = cv2.imread(str(real_data / "gelslim4_clips" / clip / "touch_000.png"))[..., ::-1]
    image = np.asarray(
        cv2.resize(panel, spec.camera.shape[::-1], interpolation=cv2.INTER_CUBIC), np.uint8
    )
    assert not compare_colours(image, spec).problem
