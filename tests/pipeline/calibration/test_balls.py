from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from pipeline.calibration import calibration_table as calibration
from pipeline.calibration.balls import find_presses, fit_table, list_fits
from pipeline.calibration.contact_circles import detect_contact_circle
from pipeline.core.errors import CalibrationError, ShapeError
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.photometric import DepthParams, estimate_depth

DIAMETER_MM = 6.31
DIAMETER_TOLERANCE = 0.10  # of the diameter, median: what the calibration promises on real presses
CENTRE_TOLERANCE_PX = 1.5  # a fortieth of the ball's radius, which tilts the look-up by as much


def hertz(shape, pixel_mm, x_px, y_px, diameter_mm, depth_mm):
    """Indentation of an elastic half-space by a ball, zero far away, mm."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    radius = diameter_mm / 2
    a = np.sqrt(radius * depth_mm)
    r = np.hypot(x - x_px, y - y_px) * pixel_mm
    out = np.maximum(r, a * (1 + 1e-9))
    outside = ((2 * a * a - out**2) * np.arcsin(a / out) + a * np.sqrt(out**2 - a * a)) / (
        np.pi * radius
    )
    return np.where(r < a, depth_mm - r * r / (2 * radius), outside).astype(np.float32)


def calibrate_by_table(pictures, still, source, diameter_mm, *, pixel_mm=None):
    """The table of presses, whether or not the description measures as well."""
    pixel_mm = pixel_mm or source.pixel_mm
    known = find_presses(pictures, still, source, diameter_mm, pixel_mm=pixel_mm, progress=SILENT)
    model = fit_table(known)
    return replace(
        calibration.make_built_in(source),
        pixel_mm=pixel_mm,
        model=model,
        presses=list_fits(len(pictures), known, model),
    )


@pytest.fixture(scope="module")
def presses():
    source = load_sensor("gelsight_mini")
    rng = np.random.default_rng(3)
    places = [(float(rng.uniform(50, 270)), float(rng.uniform(50, 190))) for _ in range(8)]
    pictures = [
        optics.render(
            source, hertz(source.camera.shape, source.pixel_mm, x, y, DIAMETER_MM, 0.6), seed=i
        )
        for i, (x, y) in enumerate(places)
    ]
    return source, places, pictures


@pytest.fixture(scope="module")
def look_up(presses):
    source, _, pictures = presses
    return calibrate_by_table(pictures, optics.render_reference(source), source, DIAMETER_MM)


def sphere_diameter(indentation_mm, contact, pixel_mm):
    """(diameter, rms residual) in mm of the sphere nearest to the contact's surface."""
    y, x = (pixel_mm * n for n in np.nonzero(contact))
    z = indentation_mm[contact].astype(np.float64)

    def off(p):
        return np.sqrt(np.maximum(p[3] ** 2 - (x - p[0]) ** 2 - (y - p[1]) ** 2, 1e-6)) + p[2] - z

    found = optimize.least_squares(off, [x.mean(), y.mean(), z.max() - 4.0, 4.0])
    return 2 * abs(found.x[3]), np.sqrt(np.mean(found.fun**2))


def test_circles_are_detected_without_hints(presses, look_up):
    _, places, _ = presses
    off = [
        np.hypot(p.x_px - x, p.y_px - y)
        for p, (x, y) in zip(look_up.presses, places, strict=True)
        if p.used
    ]
    assert len(off) >= len(places) - 1
    assert np.median(off) < CENTRE_TOLERANCE_PX


def test_a_larger_ball_is_measured_with_the_calibration_of_a_smaller_one(presses, look_up):
    source, _, _ = presses
    still = optics.render_reference(source)
    errors = []
    for i, (x, y) in enumerate([(120, 90), (180, 140), (150, 120)]):
        seen = optics.render(
            source, hertz(source.camera.shape, source.pixel_mm, x, y, 9.5, 0.5), seed=50 + i
        )
        result = estimate_depth(
            TactileFrame(sensor=source.name, image=seen, reference=still),
            source,
            look_up,
            DepthParams(),
        )
        errors.append(
            abs(
                sphere_diameter(result.indentation_mm, result.contact, look_up.pixel_mm)[0] / 9.5
                - 1
            )
        )
    assert np.median(errors) < DIAMETER_TOLERANCE


def test_the_same_presses_give_the_same_bytes(presses):
    source, _, pictures = presses
    still = optics.render_reference(source)
    first, second = (calibrate_by_table(pictures[:3], still, source, DIAMETER_MM) for _ in range(2))
    assert first.model.coefficients.tobytes() == second.model.coefficients.tobytes()


def test_a_picture_without_a_ball_is_left_out_and_reported(presses):
    source, _, pictures = presses
    still = optics.render_reference(source)
    found = calibrate_by_table([pictures[0], still, pictures[1]], still, source, DIAMETER_MM)
    assert [p.used for p in found.presses] == [True, False, True]


def test_nothing_but_untouched_pictures_is_refused(presses):
    source = presses[0]
    still = optics.render_reference(source)
    with pytest.raises(CalibrationError, match="no ball found"):
        calibrate_by_table([still], still, source, DIAMETER_MM)


def test_no_images_are_refused(presses):
    with pytest.raises(CalibrationError, match="no images"):
        calibrate_by_table([], optics.render_reference(presses[0]), presses[0], DIAMETER_MM)


@pytest.mark.parametrize("diameter_mm", [0.0, -1.0, float("nan")])
def test_an_impossible_diameter_is_refused(presses, diameter_mm):
    source, _, pictures = presses
    with pytest.raises(CalibrationError, match="cannot be seen"):
        calibrate_by_table(pictures, optics.render_reference(source), source, diameter_mm)


def test_pictures_of_another_size_are_refused(presses):
    source = presses[0]
    with pytest.raises(ShapeError, match="press 0"):
        calibrate_by_table(
            [np.zeros((10, 10, 3), np.uint8)], optics.render_reference(source), source, DIAMETER_MM
        )


def test_no_circle_is_found_where_nothing_has_changed():
    assert detect_contact_circle(np.zeros((60, 80, 3), np.float32)) is None


@pytest.mark.real_data
def test_real_presses_of_a_small_ball_measure_a_larger_one(real_data):
    import cv2

    def read(name):
        return np.ascontiguousarray(cv2.imread(str(real_data / "gsmini_balls" / name))[..., ::-1])

    source = load_sensor("gelsight_mini")
    still = read("background.png")
    small = [read(f"ball_6.310mm_{i}.png") for i in range(0, 44, 3)]
    found = calibrate_by_table(small, still, source, 6.31, pixel_mm=0.0634)
    fits = []
    for i in range(0, 23, 3):
        frame = TactileFrame(
            sensor=source.name, image=read(f"ball_9.500mm_{i}.png"), reference=still
        )
        result = estimate_depth(frame, source, found, DepthParams())
        fits.append(sphere_diameter(result.indentation_mm, result.contact, 0.0634))
    errors = np.abs(np.array(fits)[:, 0] / 9.5 - 1)
    residuals = np.array(fits)[:, 1]
    assert np.median(errors) < DIAMETER_TOLERANCE
    assert np.median(residuals) < 0.03  # mm, promised
    assert isinstance(found, calibration.Calibration)
