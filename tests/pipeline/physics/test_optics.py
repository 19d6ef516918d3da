from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import SettingProblem, ShapeError
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor

GELS = ("gelslim", "gelslim_dotless", "digit", "gelsight_mini")
MARKER_PX = 0.5  # centroid of an 8-bit, pixel-sampled dot


def level(spec):
    return np.zeros(spec.camera.shape, np.float32)


def dent(spec, depth_mm=0.8, width_mm=1.5):
    y, x = np.mgrid[: spec.camera.rows, : spec.camera.cols]
    r_sq = (x - spec.camera.cols / 2) ** 2 + (y - spec.camera.rows / 2) ** 2
    return (depth_mm * np.exp(-r_sq * (spec.pixel_mm / width_mm) ** 2)).astype(np.float32)


@pytest.mark.parametrize("name", GELS)
def test_a_flat_surface_renders_as_the_reference_to_the_byte(name):
    spec = load_sensor(name)
    assert np.array_equal(
        optics.render(spec, level(spec), seed=None), optics.render_reference(spec)
    )


@pytest.mark.parametrize("name", GELS)
def test_level_ground_changes_no_colour(name):
    spec = load_sensor(name)
    assert not optics.compute_colour_change(spec, level(spec), level(spec)).any()


@pytest.mark.parametrize("name", GELS)
def test_a_slope_that_faces_an_led_brightens_and_one_that_turns_away_darkens(name):
    spec = load_sensor(name)
    for led in spec.optics.leds:
        channel = int(np.argmax(led.rgb))
        toward = -0.3 * np.array(
            [np.cos(np.deg2rad(led.azimuth_deg)), np.sin(np.deg2rad(led.azimuth_deg))]
        )
        ones = np.ones(spec.camera.shape, np.float32)
        lit = optics.compute_colour_change(spec, toward[0] * ones, toward[1] * ones)[..., channel]
        dark = optics.compute_colour_change(spec, -toward[0] * ones, -toward[1] * ones)[
            ..., channel
        ]
        assert lit.min() > 5.0
        assert dark.max() < -5.0


@given(st.floats(0.0, 0.65), st.floats(0.0, 6.3), st.sampled_from(GELS))
@settings(max_examples=25)
def test_colour_tells_slopes_apart(steep, angle, name):
    """The 3x2 Jacobian keeps rank 2: what an inverse look-up needs. Steeper ground can hide from
    two LEDs at once.
    """
    gx = steep * np.cos(angle)
    gy = steep * np.sin(angle)
    spec = load_sensor(name)
    ones = np.ones(spec.camera.shape, np.float32)
    step = 0.02

    def colour(x, y):
        return optics.compute_colour_change(spec, x * ones, y * ones)[
            spec.camera.rows // 2, spec.camera.cols // 2
        ]

    jacobian = np.stack(
        [
            colour(gx + step, gy) - colour(gx - step, gy),
            colour(gx, gy + step) - colour(gx, gy - step),
        ]
    )
    weakest_grey_per_slope = np.linalg.svd(jacobian / (2 * step), compute_uv=False)[-1]
    assert weakest_grey_per_slope > 5.0


def test_light_is_weaker_far_from_its_led():
    spec = load_sensor("digit")
    ones = np.full(spec.camera.shape, 0.3, np.float32)
    green = optics.compute_colour_change(spec, ones, 0 * ones)[..., 1]  # green stands at the left
    assert green[160, 10] > green[160, 230] > 0


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    spec = load_sensor("digit")
    u = dent(spec)
    first, again, other = (optics.render(spec, u, seed=s) for s in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_noise_has_the_stated_strength():
    spec = load_sensor("gelslim_dotless")
    u = level(spec)
    noisy = optics.render(spec, u, seed=0).astype(float) - optics.render_reference(spec)
    inner = noisy[100:200, 100:300]  # nothing clipped there
    assert inner.std() == pytest.approx(spec.optics.noise_grey, abs=0.2)


def test_markers_are_dark_dots_that_move_outward_as_they_come_nearer():
    spec = load_sensor("gelslim")
    spec = replace(spec, markers=replace(spec.markers, jitter_mm=0.0, distortion=0.0))
    plain = optics.render_reference(load_sensor("gelslim_dotless")).astype(int)
    lift_mm = 1.0
    lifted = optics.render(spec, np.full(spec.camera.shape, lift_mm, np.float32), seed=None)
    pitch_px = spec.markers.pitch_mm / spec.pixel_mm

    def column_px(image, expected_px):
        columns = np.arange(round(expected_px - pitch_px / 2), round(expected_px + pitch_px / 2))
        dark = (plain - image).sum(axis=(0, 2))[columns].clip(0)
        assert dark.max() > 100
        return (dark * columns).sum() / dark.sum()

    still_px = spec.camera.cx_px + 4 * pitch_px
    nearer_px = spec.camera.cx_px + 4 * pitch_px * 20.0 / (20.0 - lift_mm)
    assert column_px(optics.render_reference(spec), still_px) == pytest.approx(
        still_px, abs=MARKER_PX
    )
    assert column_px(lifted, nearer_px) == pytest.approx(nearer_px, abs=MARKER_PX)


@pytest.mark.parametrize("name", GELS)
def test_extreme_surfaces_give_an_image(name):
    spec = load_sensor(name)
    for scale in (1e-6, 1e3, -1e3):
        assert optics.render(spec, scale * dent(spec), seed=0).shape == (*spec.camera.shape, 3)


def test_gaps_and_wrong_shapes_are_refused():
    spec = load_sensor("digit")
    with pytest.raises(ShapeError, match="finite"):
        optics.render(spec, np.full(spec.camera.shape, np.nan, np.float32), seed=None)
    with pytest.raises(ShapeError, match="shape"):
        optics.render(spec, np.zeros((4, 4), np.float32), seed=None)
    with pytest.raises(SettingProblem, match="colour"):
        optics.render_reference(load_sensor("soft_bubble"))


def test_markers_are_printed_off_their_places_but_the_same_each_time():
    spec = load_sensor("gelslim")
    straight = replace(spec, markers=replace(spec.markers, jitter_mm=0.0))
    wavy = optics.render_reference(spec)
    assert not np.array_equal(wavy, optics.render_reference(straight))
    assert np.array_equal(wavy, optics.render(spec, level(spec), seed=None))


def test_a_dent_takes_an_led_s_light_from_what_lies_behind_it():
    spec = load_sensor("digit")
    lit = replace(spec, optics=replace(spec.optics, shadow=0.0))
    u = dent(spec, depth_mm=1.0, width_mm=2.0)
    lost = optics.render(lit, u, seed=None).astype(int) - optics.render(spec, u, seed=None)
    green = spec.optics.leds[1]  # from the left, so its shadow lies to the right
    away = -np.array([np.cos(np.deg2rad(green.azimuth_deg)), np.sin(np.deg2rad(green.azimuth_deg))])
    behind_px = np.rint([160, 120] + 3.0 / spec.pixel_mm * away[::-1]).astype(int)
    assert lost[behind_px[0], behind_px[1], 1] > 15  # grey
    assert lost.min() >= -1  # a shadow brightens nothing
    assert not lost[:40].any()  # nor reaches the far end of the image


def test_steep_light_casts_no_shadow():
    spec = load_sensor("digit")
    u = dent(spec, depth_mm=0.5, width_mm=2.0)
    steep, none = (
        replace(spec, optics=replace(spec.optics, shadow_deg=60.0, shadow=s)) for s in (1.0, 0.0)
    )
    assert np.array_equal(optics.render(steep, u, seed=None), optics.render(none, u, seed=None))
