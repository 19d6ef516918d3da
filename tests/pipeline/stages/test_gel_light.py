from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from pipeline.base.progress import SILENT
from pipeline.calibration import near_led_prior, shading_posterior, slope_model
from pipeline.calibration.calibration_table import BallFit, make_built_in
from pipeline.geometry.rigid import translation
from pipeline.physics import optics
from pipeline.physics.slopes import compute_slopes
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes, variation
from pipeline.simulation.press import simulate_press
from pipeline.stages.depth import (
    adaptive_illumination,
    change_detection,
    drift,
    false_contacts,
    gel_surface,
    led_calibration,
    surface_refinement,
)
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, estimate_gel_depth
from pipeline.values.frames import TactileFrame
from tests.pipeline.calibration.test_balls import hertz

PARAMS = DepthParams()
TIMES_CLOSER = 2.0  # than the look-up alone; three to four are usual where shadows are long
FLAT_SHARE = 0.75  # of the depth of a flat face: the blur loses some of a steep flank
LIGHT_MM = 0.02  # of 0.15 mm; the look-up alone, without blur and shadows, is nearer here: 0.013
EITHER_MM = 0.04  # of 0.4 mm, where the lamps may give a sixth more or less than they are described to
UNUSUAL_MM = 0.06  # of 0.4 mm: one touch tells the scale of usual units alone
WALL_MM = 0.035  # of 0.5 mm; 0.022 as it is, 0.054 while a wall counted as much as any slope
BULGE_MM = 0.03  # beside 0.4 mm
CONTACT_MM = 0.06  # a flat face of 0.6 mm: vertical flanks, of which the blur keeps nine tenths


@lru_cache
def pressed(depth_mm, *, unit=None, name="star"):
    """An object pressed on a DIGIT: (sensor, frame, truth)."""
    source = load_sensor("digit") if unit is None else variation.vary_sensor(load_sensor("digit"), unit)
    thing = shapes.make_shape(name).mesh
    lowest = thing.vertices_mm[:, 2].min()
    felt = simulate_press(thing, translation(0.3, -0.4, -depth_mm - lowest), source, seed=2)
    frame = TactileFrame(sensor="digit", image=felt.image, reference=optics.render_reference(source))
    return source, frame, felt.truth


def look_up_alone(source):
    """The sensor for which the look-up alone is used."""
    return replace(source, optics=None)


def error_mm(found, truth):
    return float(np.abs(found.indentation_mm - truth.indentation_mm)[truth.contact].mean())


@pytest.mark.parametrize("unit", [None, 4])
def test_a_deep_press_is_measured_through_its_shadows(unit):
    _, frame, truth = pressed(0.6, unit=unit)
    known = load_sensor("digit")  # what every unit is taken for
    found = estimate_depth(frame, known, None, PARAMS)
    plain = estimate_depth(frame, look_up_alone(known), make_built_in(known), PARAMS)
    assert TIMES_CLOSER * error_mm(found, truth) < error_mm(plain, truth)
    assert error_mm(found, truth) < CONTACT_MM


def test_the_unchanged_inside_of_a_flat_face_is_not_taken_for_rest():
    source, frame, truth = pressed(0.7, name="square")
    found = estimate_depth(frame, source, None, PARAMS)
    assert found.indentation_mm[truth.contact].mean() > FLAT_SHARE * 0.7


def test_a_light_press_is_measured_to_a_few_hundredths_of_a_millimetre():
    source, frame, truth = pressed(0.15)
    assert error_mm(estimate_depth(frame, source, None, PARAMS), truth) < LIGHT_MM


def test_a_wall_that_looks_alike_at_any_height_does_not_pull_the_touch_flat():
    source, thing = load_sensor("gelslim"), shapes.make_shape("star").mesh
    felt = simulate_press(thing, translation(0.3, -0.4, -0.5 - thing.vertices_mm[:, 2].min()), source, seed=2)
    frame = TactileFrame(sensor="gelslim", image=felt.image, reference=optics.render_reference(source))
    found = estimate_depth(frame, source, None, PARAMS)
    assert error_mm(found, felt.truth) < WALL_MM
    off = (found.indentation_mm - felt.truth.indentation_mm)[felt.truth.contact]
    assert abs(float(off.mean())) < WALL_MM


def test_the_gel_that_bulges_beside_a_touch_is_not_taken_for_its_rest():
    frame, truth = pressed_mini(near=False)
    found = estimate_depth(frame, load_sensor("gelsight_mini"), None, PARAMS)
    bulge = truth.indentation_mm < -BULGE_MM
    assert bulge.any()
    assert float(np.median(found.indentation_mm[bulge])) < -BULGE_MM


def test_light_that_does_not_explain_the_picture_is_not_sure():
    source, frame, _ = pressed(0.6)
    lights = []
    for image in (frame.image, frame.image[:, :, ::-1]):  # red where blue should be
        odd = replace(frame, image=np.ascontiguousarray(image), reference=np.ascontiguousarray(
            frame.reference if image is frame.image else frame.reference[:, :, ::-1]))  # fmt: skip
        lights.append(estimate_gel_depth(odd, source, None, PARAMS)[1].light)
    assert adaptive_illumination.is_trusted(lights[0])
    assert lights[1] == "even"


@lru_cache
def on_another_gelslim():
    """Touches of one unit whose lamps are not as described: (frames, truths, unit)."""
    unit, thing = variation.vary_sensor(load_sensor("gelslim"), 7), shapes.make_shape("star").mesh
    lowest = thing.vertices_mm[:, 2].min()
    felt = [
        simulate_press(thing, translation(x, y, -0.5 - lowest), unit, seed=2) for x, y in ((0.3, -0.4), (-3.0, 2.0))
    ]
    still = optics.render_reference(unit)
    frames = [TactileFrame(sensor="gelslim", image=one.image, reference=still) for one in felt]
    return frames, [one.truth for one in felt], unit


def test_lamps_of_another_unit_are_told_by_its_touch():
    (frame, _), (truth, _), unit = on_another_gelslim()
    source = load_sensor("gelslim")
    found, measured = estimate_gel_depth(frame, source, None, PARAMS)
    as_told, _ = estimate_gel_depth(frame, source, None, PARAMS, light="sure")
    assert error_mm(found, truth) < 0.5 * error_mm(as_told, truth)
    off = [
        [abs(led.azimuth_deg - true.azimuth_deg) for led, true in zip(told.leds, unit.optics.leds, strict=True)]
        for told in (measured.light, source.optics)
    ]
    assert max(off[0]) < 0.5 * max(off[1])


def test_touches_of_one_unit_are_read_in_one_light_whoever_asks_first():
    frames, truths, _ = on_another_gelslim()
    source, beside = load_sensor("gelslim"), tuple(frame.image for frame in frames)
    found = [estimate_gel_depth(replace(frame, context_frames=beside), source, None, PARAMS) for frame in frames]
    lights = [measured.light for _, measured in found]
    assert all("fitted to 2 touches of the recording" in " ".join(depth_map.notes) for depth_map, _ in found)
    assert lights[0] == lights[1] == led_calibration.fit_leds(source, list(touches(frames, source)))
    for frame, truth, (depth_map, _) in zip(frames, truths, found, strict=True):
        as_told, _ = estimate_gel_depth(frame, source, None, PARAMS, light="sure")
        assert error_mm(depth_map, truth) < 0.6 * error_mm(as_told, truth)


def touches(frames, source):
    """What frames say of their unit, looked at anew."""
    for frame in frames:
        still = drift.apply_estimated_drift(frame.image, frame.reference)
        window = change_detection.detect_change(
            frame.image, still.image_8bit, source.limits.no_contact_change, source.pixel_mm
        )
        yield gel_surface.estimate_led_observation(
            gel_surface.ChangedImage(image=frame.image, reference=still, window=window, source=source,
                                calibration=make_built_in(source), smoothing_px=1.0, boundary="flat"), SILENT)  # fmt: skip


def test_one_touch_beside_tells_no_more_than_the_frame_itself():
    (frame, _), _, _ = on_another_gelslim()
    alone, _ = estimate_gel_depth(frame, load_sensor("gelslim"), None, PARAMS)
    beside, _ = estimate_gel_depth(replace(frame, context_frames=(frame.image,)), load_sensor("gelslim"), None, PARAMS)
    assert alone.indentation_mm.tobytes() == beside.indentation_mm.tobytes()


def test_the_same_picture_gives_the_same_bytes():
    source, frame, _ = pressed(0.6)
    once, again = (estimate_depth(frame, source, None, PARAMS) for _ in range(2))
    assert once.indentation_mm.tobytes() == again.indentation_mm.tobytes()


@pytest.mark.parametrize("name", ["digit", "gelslim", "gelslim_dotless", "gelsight_mini"])
def test_every_gel_whose_optics_are_described_is_corrected(name):
    source = load_sensor(name)
    assert surface_refinement.is_applicable(source, make_built_in(source))
    assert not surface_refinement.is_applicable(replace(source, optics=None), make_built_in(source))


def test_a_look_up_fitted_to_presses_is_left_as_it_is():
    fit = BallFit(index=0, x_px=9.0, y_px=9.0, radius_px=5.0, residual=0.01, used=True)
    fitted = replace(make_built_in(load_sensor("digit")), presses=(fit,))
    source, frame, _ = pressed(0.6)
    assert not surface_refinement.is_applicable(source, fitted)
    plain = estimate_depth(frame, look_up_alone(source), fitted, PARAMS)
    assert estimate_depth(frame, source, fitted, PARAMS).indentation_mm.tobytes() == plain.indentation_mm.tobytes()


def test_a_picture_with_drifted_colours_is_no_second_contact():
    source = load_sensor("digit")
    truth = hertz(source.camera.shape, source.pixel_mm, 120, 160, 6.0, 0.3)
    drifted = optics.render(source, truth, seed=1) * (1.03, 0.98, 1.02)
    image = np.clip(np.rint(drifted), 0, 255).astype(np.uint8)
    found = estimate_depth(
        TactileFrame(sensor="digit", image=image, reference=optics.render_reference(source)), source, None, PARAMS
    )
    y, x = np.nonzero(found.contact)
    assert np.hypot(x - 120, y - 160).max() * source.pixel_mm < 2.0


def test_a_shallow_plate_beside_a_touch_is_left_out_and_a_second_touch_kept():
    y, x = np.mgrid[:120, :200].astype(np.float32)
    balls = [np.maximum(d - ((x - c) ** 2 + (y - 60) ** 2) / 2000, 0) for d, c in ((0.5, 40), (0.2, 100))]
    plate = 0.1 * np.exp(-(((x - 170) / 25) ** 2 + ((y - 60) / 25) ** 2))
    surface = (balls[0] + balls[1] + plate).astype(np.float32)
    touched = (balls[0] > 0) | (balls[1] > 0) | (plate > 0.08)
    kept = false_contacts.remove_false_contacts(touched, surface, 0.05)
    assert kept[60, 40]
    assert kept[60, 100]
    assert not kept[60, 170]


def test_what_is_steep_only_where_the_part_that_is_looked_at_ends_is_left_out():
    y, x = np.mgrid[:120, :200].astype(np.float32)
    ball = np.maximum(0.5 - ((x - 40) ** 2 + (y - 60) ** 2) / 2000, 0)
    moved = np.broadcast_to(x < 150, x.shape)
    raised = 0.15 * np.where(moved, np.clip((x - 110) / 40, 0, 1), 0.0) * np.exp(-(((y - 60) / 40) ** 2))
    surface = (ball + cv2.GaussianBlur(raised, (0, 0), 1.0)).astype(np.float32)
    touched = (ball > 0) | (raised > 0.06)
    assert false_contacts.remove_false_contacts(touched, surface, 0.05)[60, 140]
    kept = false_contacts.remove_false_contacts(touched, surface, 0.05, None, moved)
    assert kept[60, 40]
    assert not kept[60, 140]


@pytest.mark.parametrize(("around_mm", "kept"), [(0.02, True), (0.14, False)])
def test_a_bump_on_gel_that_lies_too_high_is_left_out_and_a_light_touch_kept(around_mm, kept):
    y, x = np.mgrid[:120, :240].astype(np.float32)
    ball = np.maximum(0.9 - ((x - 50) ** 2 + (y - 60) ** 2) / 1000, 0)
    bump = np.maximum(0.08 - ((x - 180) ** 2 + (y - 60) ** 2) / 1000, 0)
    high = around_mm * np.exp(-(((x - 180) / 40) ** 4) - ((y - 60) / 40) ** 4)
    found = false_contacts.remove_false_contacts((ball > 0) | (bump > 0), (ball + bump + high).astype(np.float32), 0.05)
    assert found[60, 50]
    assert found[60, 180] == kept


def test_parts_of_a_light_touch_stay_though_none_has_steep_flanks():
    y, x = np.mgrid[:120, :200]
    balls = [
        np.clip(0.5 - np.hypot(x - cx, y - 60) / 60.0, 0.0, 1.0) * depth for cx, depth in ((50, 0.06), (130, 0.05))
    ]
    surface = (balls[0] + balls[1]).astype(np.float32)
    kept = false_contacts.remove_false_contacts(surface > 0, surface, 0.05)
    assert kept[60, 50]
    assert kept[60, 130]


@lru_cache
def pressed_mini(*, near):
    """An object on a Mini whose lamps light its gel as described, or stand close beside it: (frame, truth)."""
    import cv2

    source, thing = load_sensor("gelsight_mini"), shapes.make_shape("star").mesh
    truth = simulate_press(thing, translation(-3.0, 1.5, -0.4 - thing.vertices_mm[:, 2].min()), source, seed=None).truth
    still = optics.render_reference(source)
    gx, gy = compute_slopes(truth.indentation_mm, source.pixel_mm)
    change = optics.compute_colour_change(source, gx, gy)
    if near:
        before = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
        field = shading_posterior.expand_field(before.mean, *slope_model.compute_positions(source.camera.shape))[
            ..., :3
        ]
        field *= np.float32([1.6, 1.0, 0.6])[:, None]  # red tells more of slopes than it usually does, blue less
        tilted = np.stack([-gx, -gy, np.ones_like(gx)], axis=-1) / np.sqrt(1 + gx**2 + gy**2)[..., None] - (0, 0, 1)
        change = (field * tilted[:, :, None]).sum(axis=-1) / slope_model.compute_gain(still)
    light = still + cv2.GaussianBlur(change.astype(np.float32), (0, 0), optics.require_optics(source).blur_px)
    image = optics.digitise_light(light.astype(np.float32), 1.8, 1)
    return TactileFrame(sensor=source.name, image=image, reference=still), truth


@pytest.mark.parametrize("near", [False, True])
def test_the_light_that_explains_the_picture_is_taken(near, monkeypatch):
    frame, truth = pressed_mini(near=near)
    corrected, taken = adaptive_illumination.refine_in_field, []

    def watched(surface_mm, picture, *rest):
        taken.append(picture.downsampling)
        return corrected(surface_mm, picture, *rest)

    monkeypatch.setattr(adaptive_illumination, "refine_in_field", watched)
    found = estimate_depth(frame, load_sensor("gelsight_mini"), None, PARAMS)
    assert (taken[-1:] == [1]) == near  # the picture's own pixels are looked at in the light that was taken
    # Lamps that none of the usual units has: how deep a touch in their light is, it does not tell exactly.
    assert error_mm(found, truth) < (UNUSUAL_MM if near else EITHER_MM)


def test_a_touch_tells_how_its_own_lamps_light_it(monkeypatch):
    frame, truth = pressed_mini(near=True)
    own = estimate_depth(frame, load_sensor("gelsight_mini"), None, PARAMS)
    monkeypatch.setattr(adaptive_illumination, "adapt_field", lambda *_: None)
    described = estimate_depth(frame, load_sensor("gelsight_mini"), None, PARAMS)
    assert error_mm(own, truth) < 0.7 * error_mm(described, truth)


def test_a_lamp_that_stands_close_tells_little_of_slopes_beside_it():
    source = load_sensor("gelsight_mini")
    table = near_led_prior.compute_gains(source)  # corners are the picture's
    away = np.stack(np.meshgrid(np.linspace(-1, 1, table.shape[1]), np.linspace(-1, 1, table.shape[0])), axis=-1)
    for led in optics.require_optics(source).leds:
        azimuth, colour = np.radians(led.azimuth_deg), int(np.argmax(led.rgb))
        side = away @ (np.cos(azimuth), np.sin(azimuth))
        near, far = (table[..., colour][m].mean() for m in (side > 0.7, side < -0.7))
        assert near < 0.7 * far


def test_a_touch_where_lamps_tell_little_is_doubted(monkeypatch):
    source = load_sensor("gelsight_mini")
    still = optics.render_reference(source).astype(np.float32)
    told = []
    for row, col in ((120, 160), (8, 8), (8, 311), (231, 8), (231, 311)):
        touched = np.zeros(still.shape[:2], np.bool_)
        touched[row - 5 : row + 5, col - 5 : col + 5] = True
        told.append(surface_refinement.has_weak_shading(touched, still, source))
    assert not told[0]
    assert any(told[1:])
    assert not surface_refinement.has_weak_shading(np.zeros_like(touched), still, source)
    frame, _ = pressed_mini(near=True)
    assert not any("hardly tell" in note for note in estimate_depth(frame, source, None, PARAMS).notes)
    monkeypatch.setattr(surface_refinement, "has_weak_shading", lambda *_: True)
    assert any("hardly tell" in note for note in estimate_depth(frame, source, None, PARAMS).notes)


def test_pixels_of_another_width_give_the_same_shape_in_other_units():
    source = load_sensor("gelsight_mini")
    frame, _ = pressed_mini(near=False)
    wide = replace(make_built_in(source), pixel_mm=1.5 * source.pixel_mm)
    plain, wider = (
        estimate_depth(frame, source, look_up, PARAMS).indentation_mm for look_up in (make_built_in(source), wide)
    )
    assert float(wider.max() / plain.max()) == pytest.approx(1.5, rel=0.1)


@pytest.mark.real_data
def test_real_digit_balls_leave_one_contact(real_data):
    import cv2

    def read(name):
        return np.ascontiguousarray(cv2.imread(str(real_data / "digit_balls" / name))[..., ::-1])

    source, still = load_sensor("digit"), read("background.png")
    for i in range(0, 42, 6):
        frame = TactileFrame(sensor="digit", image=read(f"{i:04d}.png"), reference=still)
        n, _ = cv2.connectedComponents(estimate_depth(frame, source, None, PARAMS).contact.astype(np.uint8))
        assert n == 2  # and the background
