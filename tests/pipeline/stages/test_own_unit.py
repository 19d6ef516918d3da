"""A calibration that was made on another unit is noticed; the same unit's drift is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.stage_warnings import select_warnings
from pipeline.calibration import reference_thumbnail
from pipeline.calibration.calibration_table import make_built_in
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import instance_check
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame
from tests.pipeline.stages.test_drift import drifted

GELS = ("gelsight_mini", "gelslim", "digit")


def of_unit(name, still):
    return replace(make_built_in(load_sensor(name)), reference_thumbnail=reference_thumbnail.make_thumbnail(still))


def told_apart(name, still, now):
    return bool(instance_check.check_sensor_instance(of_unit(name, still), now))


@pytest.mark.parametrize("name", GELS)
def test_another_unit_is_told_from_one_that_has_drifted(name):
    first, second = (optics.render_reference(vary_sensor(load_sensor(name), seed, 1.0)) for seed in (1, 2))
    assert told_apart(name, first, second)
    rng = np.random.default_rng(7)
    for _ in range(4):
        gain, ramp = 1.0 + rng.uniform(-0.03, 0.03), rng.uniform(-12.0, 12.0)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        later = drifted(first, gain=gain, ramp_grey=ramp, shift_px=(2.0 * np.cos(turn), 2.0 * np.sin(turn)))
        assert not told_apart(name, first, later)


def test_light_that_no_unit_loses_in_a_day_is_doubted_although_a_drift_explains_it():
    still = optics.render_reference(load_sensor("gelsight_mini"))
    later, other = (drifted(still, gain=gain, ramp_grey=ramp) for gain, ramp in ((0.94, 14.0), (0.85, 30.0)))
    assert not told_apart("gelsight_mini", still, later)
    assert told_apart("gelsight_mini", still, other)


def test_a_touch_read_with_the_calibration_of_another_unit_is_doubted():
    source = load_sensor("digit")
    mine, other = (vary_sensor(source, seed, 1.0) for seed in (1, 2))
    still = optics.render_reference(mine)
    dent = np.zeros(source.camera.shape, np.float32)
    dent[140:180, 100:140] = 0.3
    touched = TactileFrame(sensor="digit", image=optics.render(mine, dent, seed=0), reference=still)
    alien, own = (
        estimate_depth(touched, source, of_unit("digit", optics.render_reference(unit)), DepthParams())
        for unit in (other, mine)
    )
    assert any("another unit" in told for told in select_warnings(alien.notes))
    assert not any("another unit" in told for told in own.notes)


def test_a_calibration_that_has_no_picture_tells_nothing():
    still = optics.render_reference(vary_sensor(load_sensor("digit"), 1, 1.0))
    assert instance_check.check_sensor_instance(make_built_in(load_sensor("digit")), still) == ()


def test_pictures_of_another_size_are_compared_at_the_calibrations():
    import cv2

    first, second = (optics.render_reference(vary_sensor(load_sensor("gelsight_mini"), seed, 1.0)) for seed in (1, 2))
    by_two = np.ascontiguousarray(cv2.resize(first, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA))
    assert not told_apart("gelsight_mini", first, by_two)
    assert told_apart("gelsight_mini", second, by_two)


@pytest.mark.real_data
def test_another_real_mini_is_noticed_and_one_on_its_other_recordings_is_not(real_data):
    import cv2

    def still(*place):
        return np.ascontiguousarray(cv2.imread(str(real_data.joinpath(*place)))[..., ::-1])

    balls = still("gsmini_balls", "background.png")
    things = [
        still("mini_things", path.parent.name, "ref.jpg") for path in (real_data / "mini_things").glob("*/ref.jpg")
    ]
    assert len(things) > 1
    assert all(told_apart("gelsight_mini", balls, thing) for thing in things)
    assert not any(told_apart("gelsight_mini", things[0], thing) for thing in things)


@pytest.mark.real_data
def test_a_real_gelslim_is_told_from_the_described_ones(real_data):
    import cv2

    real = np.ascontiguousarray(cv2.imread(str(real_data / "gelslim3_balls" / "ref.jpg"))[..., ::-1])
    assert told_apart("gelslim", real, optics.render_reference(load_sensor("gelslim")))
