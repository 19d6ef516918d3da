from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.calibration_table import BallFit, make_built_in
from pipeline.calibration.quality_notes import UNCALIBRATED
from pipeline.core.errors import AT_BORDER, CalibrationError, ShapeError, select_warnings
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.membrane import make_flat_membrane
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import contact, photometric
from pipeline.stages.depth.gel.settings import CONTACT
from pipeline.stages.depth.photometric import (
    DepthParams,
    estimate_depth,
    skip_without_contact,
)
from tests.pipeline.calibration.test_balls import hertz

QUIET_MM = 0.03  # what the stage promises far from a contact
CONTACT_IOU = 0.8  # the blurred rim costs one to two pixels of a contact of about 20
# of the peak: a gel's long tail counts as rest, and LEDs in their own shadow saturate
PEAK_TOLERANCE = 0.25
PARAMS = DepthParams()


def press(name, depth_mm=0.5, seed=1):
    source = load_sensor(name)
    rows, cols = source.camera.shape
    truth = hertz((rows, cols), source.pixel_mm, 0.55 * cols, 0.45 * rows, 6.31, depth_mm)
    frame = TactileFrame(
        sensor=name,
        image=optics.render(source, truth, seed=seed),
        reference=optics.render_reference(source),
    )
    return source, frame, truth


def contact_of(truth):
    return truth >= 0.5 * truth.max()  # Hertz: the edge lies at half of the peak


@pytest.mark.parametrize("name", ["gelslim", "gelslim_dotless", "digit", "gelsight_mini"])
def test_a_ball_press_is_found_with_its_depth_and_contact(name):
    source, frame, truth = press(name)
    found = estimate_depth(frame, source, None, PARAMS)
    wanted = contact_of(truth)
    assert (found.contact & wanted).sum() / (found.contact | wanted).sum() > CONTACT_IOU
    assert found.indentation_mm.max() == pytest.approx(truth.max(), rel=PEAK_TOLERANCE)
    assert np.allclose(found.depth_mm, source.rest_depth_mm - found.indentation_mm, atol=1e-5)
    assert found.source_index[1, 2] == source.camera.cols + 2


def test_far_from_the_contact_the_gel_is_at_rest():
    source, frame, truth = press("gelsight_mini")
    found = estimate_depth(frame, source, None, PARAMS)
    rows, cols = np.mgrid[: truth.shape[0], : truth.shape[1]]
    far = np.hypot(cols - 0.55 * 320, rows - 0.45 * 240) * source.pixel_mm > 8.0
    assert np.abs(found.indentation_mm[far]).max() < QUIET_MM


@pytest.mark.parametrize("name", ["gelslim", "digit", "gelsight_mini"])
def test_an_untouched_picture_is_seen_at_once(name):
    source = load_sensor(name)
    still = optics.render_reference(source)
    frame = TactileFrame(
        sensor=name,
        image=optics.render(source, np.zeros(source.camera.shape), seed=4),
        reference=still,
    )
    found = skip_without_contact(frame, source, None, PARAMS)
    assert found is not None
    assert not found.indentation_mm.any()
    assert not found.contact.any()
    assert skip_without_contact(frame, source, None, PARAMS) is found


def test_a_touch_is_never_called_untouched():
    source, frame, _ = press("digit", depth_mm=0.15)
    assert skip_without_contact(frame, source, None, PARAMS) is None


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (lambda f: replace(f, reference=None), "no reference image"),
        (lambda f: replace(f, image=f.image[:100]), "must have shape"),
        (lambda f: replace(f, image=np.zeros_like(f.image)), "is black"),
        (lambda f: replace(f, reference=np.zeros_like(f.image)), "is black"),
        (lambda f: replace(f, image=np.full_like(f.image, 255)), "image of frame 0 .* is clipped"),
        (
            lambda f: replace(f, reference=np.full_like(f.image, 254)),
            "reference of frame 0 .* is clipped",
        ),
        (lambda f: replace(f, image=np.full(f.image.shape, np.nan, np.float32)), "NaN"),
        (lambda f: replace(f, image=f.image.astype(np.int64)), "RGB of 8 bits"),
    ],
)
def test_a_frame_that_cannot_be_read_is_told_in_one_sentence(change, pattern):
    source, frame, _ = press("gelsight_mini")
    bad = change(frame)
    for run in (estimate_depth, skip_without_contact):
        with pytest.raises(ShapeError, match=pattern):
            run(bad, source, None, PARAMS)


@pytest.mark.parametrize("name", ["gelslim", "digit"])
@pytest.mark.parametrize("side", ["left", "top", "most"])
def test_a_frame_that_is_partly_black_is_refused_in_one_sentence(name, side):
    """It is neither a touch at the border nor a change of light without a dent."""
    source, frame, _ = press(name)
    rows, cols = frame.image.shape[:2]
    image = frame.image.copy()
    image[
        {"left": np.s_[:, : cols // 2], "top": np.s_[: rows // 2], "most": np.s_[rows // 4 :]}[side]
    ] = 0
    bad = replace(frame, image=image)
    with pytest.raises(ShapeError, match="is black where its reference is not"):
        estimate_depth(bad, source, None, PARAMS)


def test_a_saturated_picture_is_doubted_and_stays_finite():
    source, frame, _ = press("gelsight_mini")
    nearly = np.where(
        np.arange(frame.image.shape[0])[:, None, None] < 4, frame.image, np.uint8(255)
    )
    found = estimate_depth(replace(frame, image=nearly), source, None, PARAMS)
    assert np.isfinite(found.indentation_mm).all()
    assert any("saturated" in warning for warning in select_warnings(found.notes))


def test_a_contact_at_the_image_border_is_told():
    source = load_sensor("gelsight_mini")
    truth = hertz(source.camera.shape, source.pixel_mm, 4, 120, 6.31, 0.6)
    frame = TactileFrame(
        sensor=source.name,
        image=optics.render(source, truth, seed=1),
        reference=optics.render_reference(source),
    )
    found = estimate_depth(frame, source, None, PARAMS)
    assert AT_BORDER in select_warnings(found.notes)
    assert found.indentation_mm.max() == pytest.approx(truth.max(), rel=PEAK_TOLERANCE)


def test_the_frames_own_camera_replaces_the_sensors():
    source, frame, _ = press("gelsight_mini")
    camera = replace(source.camera, fx_px=400.0, fy_px=400.0)
    assert estimate_depth(replace(frame, camera=camera), source, None, PARAMS).camera == camera


def test_a_sensor_that_differs_in_its_limits_or_optics_alone_keeps_them_behind_the_frames_own_camera():
    source, frame, _ = press("digit", depth_mm=0.9)
    frame = replace(frame, camera=replace(source.camera, fx_px=1.01 * source.camera.fx_px))
    usual = estimate_depth(frame, source, None, PARAMS)
    shallow = replace(source, limits=replace(source.limits, indentation_max_mm=0.2))
    assert estimate_depth(frame, shallow, None, PARAMS).indentation_mm.max() == pytest.approx(0.2)
    red = replace(
        source.optics, leds=tuple(replace(led, rgb=(60.0, 9.0, 9.0)) for led in source.optics.leds)
    )
    other = estimate_depth(frame, replace(source, optics=red), None, PARAMS)
    assert not np.array_equal(other.indentation_mm, usual.indentation_mm)


def test_a_sensor_that_rests_deeper_is_measured_at_its_own_scale():
    near, frame, _ = press("gelslim_dotless")
    far = replace(
        near,
        rest_depth_mm=1.5 * near.rest_depth_mm,
        membrane=make_flat_membrane(1.5 * near.membrane.z_mm[0, 0], 20.0, 20.0),
    )
    found = {
        sensor: estimate_depth(frame, spec, None, PARAMS)
        for sensor, spec in (("near", near), ("far", far))
    }
    assert found["far"].indentation_mm.max() == pytest.approx(
        1.5 * found["near"].indentation_mm.max(), rel=0.1
    )


def test_a_reference_changed_in_place_is_another_reference():
    source, frame, _, _ = bubble()
    rest = np.array(frame.reference)
    still = replace(frame, image=rest, reference=rest)
    before = skip_without_contact(still, source, None, PARAMS)
    rest += 1.0
    after = skip_without_contact(still, source, None, PARAMS)
    np.testing.assert_allclose(after.depth_mm, before.depth_mm + 1.0, rtol=1e-6)


def test_a_look_up_of_another_sensor_is_refused():
    from pipeline.calibration.calibration_table import make_built_in

    source, frame, _ = press("gelsight_mini")
    with pytest.raises(CalibrationError, match="made for 'digit'"):
        estimate_depth(frame, source, make_built_in(load_sensor("digit")), PARAMS)


def test_the_same_frame_gives_the_same_bytes():
    source, frame, _ = press("gelslim")
    first, second = (
        estimate_depth(frame, source, None, PARAMS).indentation_mm.tobytes() for _ in range(2)
    )
    assert first == second


def bubble(depth_mm=4.0, seed=0):
    source = load_sensor("soft_bubble")
    rng = np.random.default_rng(seed)
    rest = source.rest_depth_mm.astype(np.float32)
    y, x = np.mgrid[: rest.shape[0], : rest.shape[1]]
    r = np.hypot(x - 90, y - 70) * source.pixel_mm
    moved = np.where(
        r < 6,
        depth_mm - r * r / 40,
        (depth_mm - 0.9) * np.maximum(0, np.log(40 / np.maximum(r, 6)) / np.log(40 / 6)),
    )
    noisy = rest - moved + rng.normal(0, 0.3, rest.shape)
    return (
        source,
        TactileFrame(sensor=source.name, image=noisy.astype(np.float32), reference=rest),
        moved,
        r,
    )


def test_a_bubble_is_measured_against_its_own_rest():
    source, frame, moved, r = bubble()
    found = estimate_depth(frame, source, None, PARAMS)
    assert np.abs(found.indentation_mm - moved).mean() < 0.3  # mm, the noise of one reading
    assert found.contact[70, 90]
    assert not found.contact[r > 20].any()


def test_a_bubbles_gaps_are_filled_or_left_without_a_value():
    source, frame, moved, _ = bubble()
    image = np.array(frame.image)
    image[60:64, 80:84] = 0.0
    image[100:140, 0:60] = np.nan
    image[20, 20] = 6553.5
    found = estimate_depth(replace(frame, image=image), source, None, PARAMS)
    assert found.indentation_mm[61, 81] == pytest.approx(moved[61, 81], abs=0.5)
    assert np.isnan(found.indentation_mm[125, 20])
    assert not found.contact[125, 20]
    assert abs(found.indentation_mm[20, 20]) < 2.0
    assert any("not measured" in note for note in found.notes)
    assert any("moved by more" in note for note in found.notes)


def ring_on_a_bubble(seed):
    from pipeline.physics.simulation import poses, shapes
    from pipeline.physics.simulation.press import simulate_press as pressed

    source = load_sensor("soft_bubble")
    thing = shapes.make_shape("ellipse").mesh
    touch = pressed(thing, poses.make_paper_grid(thing, n=12, seed=50)[7], source, seed=seed)
    rest = source.rest_depth_mm.astype(np.float32)
    return source, TactileFrame(sensor=source.name, image=touch.image, reference=rest), touch.truth


def test_a_bubble_over_a_hollow_object_is_touched_along_the_rim_only():
    source, frame, truth = ring_on_a_bubble(seed=4)
    found = estimate_depth(frame, source, None, PARAMS)
    rows, cols = np.nonzero(truth.contact)
    assert not found.contact[round(rows.mean()), round(cols.mean())]
    assert (found.contact & truth.contact).sum() > 0.7 * truth.contact.sum()
    # the rim is two pixels wide: two or three more on each side
    assert found.contact.sum() < 3.5 * truth.contact.sum()
    moved = np.abs(found.indentation_mm - truth.indentation_mm)
    assert moved[~truth.contact].mean() < 0.06  # mm, an eighth of the noise of a reading
    assert moved[truth.contact].mean() < 0.2  # mm, half of it


def test_a_bubble_read_without_noise_is_read_exactly():
    source, frame, truth = ring_on_a_bubble(seed=None)
    found = estimate_depth(frame, source, None, PARAMS)
    assert np.abs(found.indentation_mm - truth.indentation_mm)[truth.contact].mean() < 0.02  # mm


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_bubbles_contact_hardly_hangs_on_its_assumed_tension(share):
    source, frame, _ = ring_on_a_bubble(seed=4)
    other = replace(
        source, bubble=replace(source.bubble, height_mm=share * source.bubble.height_mm)
    )
    usual = estimate_depth(frame, source, None, PARAMS)
    found = estimate_depth(frame, other, None, PARAMS)
    assert (usual.contact & found.contact).sum() > 0.6 * (usual.contact | found.contact).sum()
    assert np.abs(usual.indentation_mm - found.indentation_mm).mean() < 0.03  # mm


def test_a_bubble_seen_by_more_pixels_has_the_same_contact():
    import cv2

    source, frame, _ = ring_on_a_bubble(seed=4)
    c = source.camera
    k = 2
    camera = Camera(
        rows=k * c.rows,
        cols=k * c.cols,
        fx_px=k * c.fx_px,
        fy_px=k * c.fy_px,
        cx_px=k * c.cx_px + 0.5,
        cy_px=k * c.cy_px + 0.5,
    )
    image, rest = (np.kron(a, np.ones((k, k), np.float32)) for a in (frame.image, frame.reference))
    fine = estimate_depth(
        replace(frame, image=image, reference=rest, camera=camera), source, None, PARAMS
    )
    back = (
        cv2.resize(fine.contact.astype(np.float32), (c.cols, c.rows), interpolation=cv2.INTER_AREA)
        > 0.5
    )
    usual = estimate_depth(frame, source, None, PARAMS).contact
    assert (back & usual).sum() > 0.8 * (back | usual).sum()


def test_a_resting_bubble_is_untouched():
    source, frame, _, _ = bubble()
    rng = np.random.default_rng(7)
    still = (np.asarray(frame.reference) + rng.normal(0, 0.3, source.camera.shape)).astype(
        np.float32
    )
    assert skip_without_contact(replace(frame, image=still), source, None, PARAMS) is not None
    assert skip_without_contact(frame, source, None, PARAMS) is None


def test_a_bubble_without_any_reading_is_refused():
    source, frame, _, _ = bubble()
    with pytest.raises(ShapeError, match="no depth at all"):
        estimate_depth(
            replace(frame, image=np.full_like(frame.image, np.nan)), source, None, PARAMS
        )
    for nothing in (0.0, np.nan, -np.inf):
        with pytest.raises(ShapeError):
            skip_without_contact(
                replace(frame, reference=np.full_like(frame.image, nothing)), source, None, PARAMS
            )


@pytest.mark.parametrize("kind", [np.bool_, np.uint16, np.int32, np.complex64])
def test_a_bubbles_depth_in_another_type_of_number_is_refused(kind):
    source, frame, _, _ = bubble()
    bad = replace(frame, image=frame.image.astype(kind), reference=frame.reference.astype(kind))
    with pytest.raises(ShapeError, match="float32 in millimetres"):
        estimate_depth(bad, source, None, PARAMS)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 3e38])
def test_a_look_up_without_numbers_is_refused(wrong):
    source, frame, _ = press("digit")
    good = make_built_in(source)
    bad = replace(
        good, model=replace(good.model, coefficients=np.full_like(good.model.coefficients, wrong))
    )
    with pytest.raises(CalibrationError, match="digit"):
        estimate_depth(frame, source, bad, PARAMS)


def test_a_flat_punch_is_touched_inside_its_rim_too():
    y, x = np.mgrid[:120, :120]
    outside = np.maximum(np.maximum(abs(x - 60) - 20, abs(y - 60) - 20), 0)
    surface = (0.5 * np.exp(-outside / 8.0)).astype(np.float32)
    found = contact.detect_contact(
        surface, 0.05, least_mm=0.03, pressure_share=0.25, settings=CONTACT
    )
    assert found[60, 60]
    assert not found[60, 100]


@pytest.mark.real_data
def test_real_bubble_contacts_appear_when_they_should(real_data):
    file = np.load(real_data / "punyo_bubble" / "depth_sequence.npz")
    readings = file["depth_u16_0p1mm"].astype(np.float32) * np.float32(0.1)
    k = file["K"]
    camera = Camera(rows=480, cols=640, fx_px=k[0, 0], fy_px=k[1, 1], cx_px=k[0, 2], cy_px=k[1, 2])
    source = load_sensor("soft_bubble")
    for i in (1, 4, 13, 20, 32):
        frame = TactileFrame(
            sensor=source.name, image=readings[i], reference=readings[0], camera=camera
        )
        touched = estimate_depth(frame, source, None, PARAMS).contact.any()
        assert touched == (65 <= file["frame"][i] <= 109)


@pytest.mark.real_data
def test_real_digit_presses_all_show_one_contact(real_data):
    import cv2

    def read(name):
        return np.ascontiguousarray(cv2.imread(str(real_data / "digit_balls" / name))[..., ::-1])

    source = load_sensor("digit")
    still = read("background.png")
    for i in range(0, 42, 6):
        frame = TactileFrame(sensor=source.name, image=read(f"{i:04d}.png"), reference=still)
        assert skip_without_contact(frame, source, None, PARAMS) is None
        assert estimate_depth(frame, source, None, PARAMS).contact.sum() > 200


def test_a_recorded_frame_says_first_what_its_look_up_is_worth():
    source, frame, _ = press("gelsight_mini")
    assert estimate_depth(frame, source, None, PARAMS).notes[0].startswith(UNCALIBRATED)
    pressed = replace(
        make_built_in(source),
        presses=(BallFit(index=0, x_px=9, y_px=9, radius_px=9, residual=0, used=True),),
    )
    assert "uncalibrated" not in estimate_depth(frame, source, pressed, PARAMS).notes[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p[:, :, ::-1], "red and blue look swapped (in Python give image[..., ::-1])"),
        (lambda p: p[::-1], "mirrored top to bottom"),
        (lambda p: p[::-1, ::-1], "rotated by 180 degrees"),
    ],
)
def test_a_recording_whose_colours_lie_elsewhere_is_doubted_unless_a_unit_was_calibrated_so(
    change, words
):
    source, frame, _ = press("digit")
    assert not any(
        "reference image is not" in note
        for note in estimate_depth(frame, source, None, PARAMS).notes
    )
    image, reference = (np.ascontiguousarray(change(a)) for a in (frame.image, frame.reference))
    changed = replace(frame, image=image, reference=reference)
    assert any(
        words in note
        for note in select_warnings(estimate_depth(changed, source, None, PARAMS).notes)
    )
    own = replace(
        make_built_in(source),
        presses=(BallFit(index=0, x_px=9, y_px=9, radius_px=9, residual=0, used=True),),
    )
    assert not any(words in note for note in estimate_depth(changed, source, own, PARAMS).notes)


def test_a_mirrored_mini_is_told_by_a_touch_as_its_lights_are_nearly_alike_from_both_sides():
    source, frame, _ = press("gelsight_mini")
    image, reference = (np.ascontiguousarray(a[:, ::-1]) for a in (frame.image, frame.reference))
    mirrored = replace(frame, image=image, reference=reference)
    assert "mirrored left to right" in photometric.describe_mismatch(mirrored, source)
    assert not photometric.describe_mismatch(
        replace(mirrored, image=reference), source
    )  # nothing touches: nobody can tell
    assert not photometric.describe_mismatch(frame, source)


@pytest.mark.real_data
def test_right_pictures_of_real_units_are_not_called_odd_and_mirrored_ones_of_a_mini_are(real_data):
    import cv2

    def read(*where):
        return np.ascontiguousarray(cv2.imread(str(real_data.joinpath(*where)))[..., ::-1])

    def describe_mismatch(name, image, reference):
        frame = TactileFrame(
            sensor=name,
            image=np.ascontiguousarray(image),
            reference=np.ascontiguousarray(reference),
        )
        return photometric.describe_mismatch(frame, load_sensor(name))

    for folder in sorted((real_data / "mini_things").iterdir()):
        still = read(folder, "ref.jpg")
        for file in sorted(folder.glob("*.jpg"))[:2]:
            assert not describe_mismatch("gelsight_mini", read(file), still)
    still = read("gsmini_balls", "background.png")
    balls = [
        read(file) for file in sorted((real_data / "gsmini_balls").glob("ball_9.500mm_*.png"))[::6]
    ]
    assert not any(describe_mismatch("gelsight_mini", ball, still) for ball in balls)
    found = [describe_mismatch("gelsight_mini", ball[:, ::-1], still[:, ::-1]) for ball in balls]
    assert sum("mirrored" in clause for clause in found) >= len(balls) - 1
