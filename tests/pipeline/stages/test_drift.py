"""Light and place of a picture that have drifted since its reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.gel import drift, rest
from pipeline.stages.depth.gel.change import observe_change
from pipeline.stages.depth.photometric import DepthParams, estimate_depth, skip_without_contact
from tests.pipeline.stages.test_depth import contact_of, press

PARAMS = DepthParams()


def drifted(image, *, gain=1.0, ramp_grey=0.0, shift_px=(0.0, 0.0), seed=0):
    """The picture under more light, a ramp from left to right, and moved."""
    import cv2

    rows, cols = image.shape[:2]
    by = np.array([[1.0, 0.0, shift_px[0]], [0.0, 1.0, shift_px[1]]])
    moved = cv2.warpAffine(
        image.astype(np.float32),
        by,
        (cols, rows),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    light = gain * moved + (ramp_grey * np.linspace(-0.5, 0.5, cols))[None, :, None]
    return np.clip(
        np.rint(light + np.random.default_rng(seed).normal(0, 1.5, image.shape)), 0, 255
    ).astype(np.uint8)


def frame(source, image, reference=None):
    still = optics.render_reference(source) if reference is None else reference
    return TactileFrame(sensor=source.name, image=image, reference=still)


@pytest.mark.parametrize("name", ["gelslim", "digit", "gelsight_mini"])
@pytest.mark.parametrize(
    "how",
    [
        {"gain": 1.06},
        {"ramp_grey": 20.0},
        {"shift_px": (2.0, -1.0)},
        {"gain": 0.95, "ramp_grey": -12.0, "shift_px": (-1.0, 1.5)},
    ],
)
def test_a_picture_that_only_drifted_is_untouched(name, how):
    source = load_sensor(name)
    image = drifted(optics.render_reference(source), **how)
    found = skip_without_contact(frame(source, image), source, None, PARAMS)
    if found is None:  # then a closer look must not find anything either
        found = estimate_depth(frame(source, image), source, None, PARAMS)
    assert not found.contact.any()
    assert not found.indentation_mm.any()


def test_removed_drift_is_noted():
    source = load_sensor("gelslim")
    image = drifted(optics.render_reference(source), gain=1.08, shift_px=(2.0, 0.0))
    notes = " ".join(skip_without_contact(frame(source, image), source, None, PARAMS).notes)
    assert "the light has drifted" in notes
    assert "moved by 2.0 px" in notes
    assert "larger than the view" in notes  # nobody can tell it from one


def test_shift_gain_and_ramp_are_measured():
    still = optics.render_reference(load_sensor("gelslim"))
    found, foreign, _ = drift.fit_drift(
        drifted(still, gain=1.04, ramp_grey=10.0, shift_px=(1.6, -0.7)), still
    )
    assert not foreign
    assert found.shift_px == pytest.approx((1.6, -0.7), abs=0.1)
    assert found.gain == pytest.approx([1.04] * 3, abs=0.01)
    assert found.ramp_grey[:, 0] == pytest.approx([5.0] * 3, abs=0.5)


def test_what_is_removed_grows_with_the_drift_without_a_jump():
    still = optics.render_reference(load_sensor("gelsight_mini"))
    fits = [
        drift.fit_drift(drifted(still, ramp_grey=ramp), still)[0]
        for ramp in np.arange(3.0, 6.0, 0.1)
    ]
    removed = np.array([0.0 if fit is None else fit.ramp_grey[:, 0].mean() for fit in fits])
    assert removed[0] == 0.0  # as little is what a touch does to the light far from it
    assert removed[-1] == pytest.approx(5.9 / 2, abs=0.3)
    assert np.abs(np.diff(removed)).max() < 1.2


@pytest.mark.parametrize("name", ["digit", "gelsight_mini"])
def test_a_touch_is_no_drift_and_is_found_through_one(name):
    source, touch, truth = press(name, depth_mm=0.4)
    state = rest.describe_rest(touch, source, None, PARAMS, SILENT)
    assert observe_change(touch.image, touch.reference, state).rest.drift is None
    image = drifted(touch.image, gain=1.03, ramp_grey=12.0, shift_px=(0.0, 1.0))
    found = estimate_depth(replace(touch, image=image), source, None, PARAMS)
    wanted = contact_of(truth)
    assert (found.contact & wanted).sum() / (found.contact | wanted).sum() > 0.75


def test_the_reference_of_another_unit_is_noticed():
    source = load_sensor("digit")
    image, reference = (optics.render_reference(vary_sensor(source, seed, 1.5)) for seed in (1, 2))
    found = estimate_depth(frame(source, image, reference), source, None, PARAMS)
    assert any("new reference" in note for note in found.notes)


def test_a_picture_all_white_is_no_drift():
    still = optics.render_reference(load_sensor("gelsight_mini"))
    assert drift.fit_drift(np.full_like(still, 255), still)[0] is None


def test_a_picture_with_large_markers_that_has_moved_is_put_back():
    source = load_sensor("gelslim")
    assert source.markers is not None
    markers = replace(source.markers, pitch_mm=0.9, radius_mm=0.2, darkness=0.95)
    still = optics.render_reference(replace(source, markers=markers))
    found, *_ = drift.fit_drift(drifted(still, shift_px=(-2.0, 2.0)), still)
    assert found is not None
    assert found.shift_px == pytest.approx((-2.0, 2.0), abs=0.1)


def test_a_face_that_fills_the_view_is_not_taken_for_drift_nor_drift_for_a_face():
    source = load_sensor("gelsight_mini")
    rows, cols = source.camera.shape
    outside = (
        np.maximum(np.abs(np.arange(cols) - 0.5 * (cols - 1)) - 0.47 * cols, 0.0) * source.pixel_mm
    )
    face = np.tile(0.5 * np.exp(-outside / 0.3), (rows, 1)).astype(np.float32)
    how = {"gain": 0.97, "ramp_grey": 12.0}
    found = estimate_depth(
        frame(source, drifted(optics.render(source, face, seed=1), **how)), source, None, PARAMS
    )
    assert found.contact.mean() > 0.9
    assert any("fills the view" in note for note in found.notes)
    assert any("the light has drifted" in note for note in found.notes)
    alone = frame(source, drifted(optics.render_reference(source), **how))
    found = estimate_depth(alone, source, None, PARAMS)
    assert not found.contact.any()
    assert any("larger than the view" in note for note in found.notes)  # which shows no rim


@pytest.mark.real_data
def test_a_real_reference_that_has_moved_far_is_put_back(real_data):
    import cv2

    still = np.ascontiguousarray(
        cv2.imread(str(real_data / "digit_balls" / "background.png"))[..., ::-1]
    )
    for seed in range(3):
        found, *_ = drift.fit_drift(drifted(still, shift_px=(3.0, -4.0), seed=seed), still)
        assert found is not None
        assert found.shift_px == pytest.approx((3.0, -4.0), abs=0.1)


def test_the_prior_pulls_the_whole_shift_to_none_and_not_its_last_step():
    """Blocks without texture tell nothing of a shift: what earlier steps have moved is taken
    back.
    """
    flat = np.full((12, 3), 90.0, np.float32)
    place = np.zeros((12, 2), np.float32)
    still = drift._Blocks(mean=flat, by_x=np.zeros_like(flat), by_y=np.zeros_like(flat))
    shift, weight = np.array([1.5, -0.5]), np.ones(12, np.float32)
    solution, *_ = drift._solve(flat, still, place, shift, weight, [1.0])
    np.testing.assert_allclose(solution[12:], [-1.5, 0.5], atol=1e-9)


@pytest.mark.parametrize("name", ["gelslim", "digit", "gelsight_mini"])
@pytest.mark.parametrize("exposure", [0.5, 0.8, 1.25])
def test_another_exposure_is_taken_out_and_hides_no_touch(name, exposure):
    source, touch, truth = press(name, depth_mm=0.4)
    wanted = contact_of(truth)
    found = estimate_depth(
        replace(touch, image=drifted(touch.image, gain=exposure)), source, None, PARAMS
    )
    assert (found.contact & wanted).sum() / (found.contact | wanted).sum() > 0.6
    still = frame(source, drifted(touch.reference, gain=exposure), touch.reference)
    found = estimate_depth(still, source, None, PARAMS)
    assert not found.contact.any()
    assert any("the light has drifted" in note for note in found.notes)
