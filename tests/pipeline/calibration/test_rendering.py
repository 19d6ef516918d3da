from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.errors import CalibrationError, ShapeError
from pipeline.calibration import rendering as lookup
from pipeline.calibration.balls import calibrate_balls
from pipeline.calibration.lookup import built_in, slopes
from pipeline.physics import optics
from pipeline.recordings.pictures import rgb
from pipeline.sensors.spec import sensor

SLOPE = 0.03  # mm/mm rms: 8 bits, the smoothing of the look-up, the table's nodes
LEVEL = 0.01  # mm/mm rms where nothing touches
MINI_MM_PER_PX = 0.0634


def dent(spec, depth_mm, width_mm, at=(0.5, 0.5)):
    y, x = np.mgrid[: spec.camera.rows, : spec.camera.cols]
    r_sq = (x - at[0] * spec.camera.cols) ** 2 + (y - at[1] * spec.camera.rows) ** 2
    return (depth_mm * np.exp(-r_sq * (spec.pixel_mm / width_mm) ** 2)).astype(np.float32)


def rms(off):
    return float(np.sqrt(np.mean(off**2)))


def seen_again(calibration, spec, reference, indentation):
    picture = lookup.rendered(calibration, reference, indentation, spec, seed=None)
    return np.stack(slopes(calibration, picture, reference, markers=spec.markers))


@pytest.mark.parametrize("name", ["digit", "gelsight_mini", "gelslim_dotless"])
@pytest.mark.parametrize("at", [(0.5, 0.5), (0.25, 0.7)])
def test_the_look_up_sees_the_slopes_that_were_rendered_with_it(name, at):
    spec = sensor(name)
    u = dent(spec, 0.5, 2.0, at)
    true = np.stack(optics.slopes(u, spec.pixel_mm))
    seen = seen_again(built_in(spec), spec, optics.untouched(spec), u)
    touched = u > 0.02
    assert rms((seen - true)[:, touched]) < SLOPE
    assert rms((seen - true)[:, ~touched]) < LEVEL


def test_a_real_calibration_sees_the_slopes_that_were_rendered_with_it(real_data):
    spec = sensor("gelsight_mini")
    folder = real_data / "gsmini_balls"
    reference = rgb(folder / "background.png")
    presses = [rgb(p) for p in sorted(folder.glob("ball_6.310mm_*.png"))[:12]]
    found = calibrate_balls(presses, reference, spec, 6.31, pixel_mm=MINI_MM_PER_PX)
    u = dent(spec, 0.4, 2.0)
    true = np.stack(optics.slopes(u, MINI_MM_PER_PX))
    seen = seen_again(found, spec, reference, u)
    assert rms((seen - true)[:, u > 0.02]) < SLOPE


def test_usual_colours_bring_the_picture_nearer_and_keep_the_slopes():
    spec = sensor("digit")
    shadowless = replace(spec, optics=replace(spec.optics, shadow=0.0))
    reference, look_up = optics.untouched(spec), built_in(spec)
    places = [(0.3, 0.3), (0.7, 0.3), (0.5, 0.5), (0.3, 0.7), (0.7, 0.7)]
    presses = [optics.render(shadowless, dent(spec, 0.7, 1.5, at), seed=k) for k, at in enumerate(places)]
    usual = lookup.usual(look_up, presses, reference, spec)
    u = dent(spec, 0.5, 2.0, (0.45, 0.6))
    real = optics.render(shadowless, u, seed=None).astype(float)
    bare, nearer = (
        lookup.rendered(look_up, reference, u, spec, seed=None, usual_change=known) for known in (None, usual)
    )
    touched = u > 0.02
    assert rms((nearer - real)[touched]) < 0.7 * rms((bare - real)[touched])
    true = np.stack(optics.slopes(u, spec.pixel_mm))
    assert rms((np.stack(slopes(look_up, nearer, reference)) - true)[:, touched]) < SLOPE


def test_pictures_without_a_touch_tell_no_usual_colours():
    spec = sensor("digit")
    with pytest.raises(CalibrationError, match="no touch"):
        lookup.usual(built_in(spec), [optics.untouched(spec)], optics.untouched(spec), spec)


def test_level_ground_leaves_the_reference_to_the_byte():
    spec = sensor("gelslim")
    reference = optics.untouched(spec)
    level = np.zeros(spec.camera.shape, np.float32)
    again = lookup.rendered(built_in(spec), reference, level, spec, seed=None)
    assert np.abs(again.astype(int) - reference).max() <= 1  # grey level: taken apart and put together


def test_markers_of_the_reference_move_with_the_surface():
    spec = sensor("gelslim")
    reference = optics.untouched(spec)
    level = np.zeros(spec.camera.shape, np.float32)
    shear = np.zeros((*spec.camera.shape, 2), np.float32)
    shear[..., 1] = 4 * spec.pixel_mm
    moved = lookup.rendered(built_in(spec), reference, level, spec, seed=None, shear_mm=shear).astype(int)
    plain = optics.untouched(sensor("gelslim_dotless")).astype(int)
    before, after = (plain - reference)[20:-24, 20:-20], (plain - moved)[24:-20, 20:-20]
    assert np.corrcoef(before.ravel(), after.ravel())[0, 1] > 0.97


def test_a_calibration_of_another_sensor_or_size_is_refused():
    spec, other = sensor("digit"), sensor("gelsight_mini")
    level = np.zeros(spec.camera.shape, np.float32)
    with pytest.raises(CalibrationError, match="gelsight_mini"):
        lookup.rendered(built_in(other), optics.untouched(spec), level, spec, seed=None)
    with pytest.raises(ShapeError):
        lookup.rendered(built_in(spec), optics.untouched(spec), level[:-1], spec, seed=None)


def test_only_the_last_few_tables_are_kept():
    first = lookup.table(built_in(sensor("digit")))
    assert lookup.table(built_in(sensor("digit"))) is first
    assert len(lookup._tables) <= lookup._KEPT
