"""A calibration of another sensor instance is noticed; drift of the same instance is not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.calibration.calibration_table import make_built_in, make_thumbnail
from pipeline.core.errors import select_warnings
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import instance_check
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from tests.pipeline.stages.test_drift import drifted

GELS = ("gelsight_mini", "gelslim", "digit")


def make_calibration(name, reference):
    """The described table, as if calibrated with this reference image."""
    return replace(make_built_in(load_sensor(name)), reference_thumbnail=make_thumbnail(reference))


def render_instance(name, seed):
    return optics.render_reference(vary_sensor(load_sensor(name), seed, 1.0))


def is_warned(name, calibrated_with, now):
    return bool(instance_check.check_sensor_instance(make_calibration(name, calibrated_with), now))


@pytest.mark.parametrize("name", GELS)
def test_another_instance_is_distinguished_from_drift(name):
    first, second = (render_instance(name, seed) for seed in (1, 2))
    assert is_warned(name, first, second)
    rng = np.random.default_rng(7)
    for _ in range(4):
        gain = 1.0 + rng.uniform(-0.03, 0.03)
        ramp = rng.uniform(-12.0, 12.0)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        later = drifted(
            first, gain=gain, ramp_grey=ramp, shift_px=(2.0 * np.cos(angle), 2.0 * np.sin(angle))
        )
        assert not is_warned(name, first, later)


def test_more_drift_than_one_instance_has_in_a_day_is_warned_of():
    reference = optics.render_reference(load_sensor("gelsight_mini"))
    later, other = (
        drifted(reference, gain=gain, ramp_grey=ramp) for gain, ramp in ((0.94, 14.0), (0.85, 30.0))
    )
    assert not is_warned("gelsight_mini", reference, later)
    assert is_warned("gelsight_mini", reference, other)


def test_depth_with_the_calibration_of_another_instance_is_warned_of():
    source = load_sensor("digit")
    instance = vary_sensor(source, 1, 1.0)
    dent = np.zeros(source.camera.shape, np.float32)
    dent[140:180, 100:140] = 0.3
    image = optics.render(instance, dent, seed=0)
    reference = optics.render_reference(instance)
    frame = TactileFrame(sensor="digit", image=image, reference=reference)
    own, other = (
        estimate_depth(
            frame, source, make_calibration("digit", render_instance("digit", seed)), DepthParams()
        )
        for seed in (1, 2)
    )
    assert any("another instance" in warning for warning in select_warnings(other.notes))
    assert not any("another instance" in warning for warning in select_warnings(own.notes))


def test_a_calibration_without_a_reference_image_is_not_checked():
    reference = render_instance("digit", 1)
    assert (
        instance_check.check_sensor_instance(make_built_in(load_sensor("digit")), reference) == ()
    )


def test_images_of_another_size_are_compared_at_the_calibrations():
    first, second = (render_instance("gelsight_mini", seed) for seed in (1, 2))
    smaller = np.ascontiguousarray(
        cv2.resize(first, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA)
    )
    assert not is_warned("gelsight_mini", first, smaller)
    assert is_warned("gelsight_mini", second, smaller)


def read_image(*parts):
    return np.ascontiguousarray(cv2.imread(str(parts[0].joinpath(*parts[1:])))[..., ::-1])


@pytest.mark.real_data
def test_another_real_mini_is_noticed_and_the_same_one_is_not(real_data):
    balls = read_image(real_data, "gsmini_balls", "background.png")
    things = [read_image(path) for path in (real_data / "mini_things").glob("*/ref.jpg")]
    assert len(things) > 1
    assert all(is_warned("gelsight_mini", balls, thing) for thing in things)
    assert not any(is_warned("gelsight_mini", things[0], thing) for thing in things)


@pytest.mark.real_data
def test_a_real_gelslim_is_distinguished_from_the_described_one(real_data):
    real = read_image(real_data, "gelslim3_balls", "ref.jpg")
    assert is_warned("gelslim", real, optics.render_reference(load_sensor("gelslim")))
