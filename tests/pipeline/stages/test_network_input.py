"""What the network that reads gels looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import gel_network_input


def bump(rows, cols, row, col, width):
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    return np.exp(-((x - col) ** 2 + (y - row) ** 2) / width**2).astype(np.float32)


@pytest.mark.parametrize("shape", [(240, 320), (320, 240), (320, 427), (68, 90), (1280, 1708), (128, 128), (100, 400)])
def test_resampling_to_the_grid_and_back_keeps_positions(shape):
    at = gel_network_input.make_grid(shape)
    rows, cols = shape
    there = bump(rows, cols, 0.4 * rows, 0.6 * cols, 0.2 * min(shape))
    back = at.resample_to_image(at.resample_to_grid(there))
    assert back.shape == shape
    assert np.abs(back - there).max() < 0.05
    assert at.pixels_per_cell == pytest.approx(max(max(shape) / 160, min(shape) / 120), rel=0.02)


def seen(source, touched, still, height=None):
    height = np.zeros(source.camera.shape, np.float32) if height is None else height
    light = gel_network_input.describe_light(source)
    return gel_network_input.prepare_input(touched, still.astype(np.float32), height, height > 0.1, source, light)


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim_dotless"])
def test_the_described_light_gives_the_slopes_of_a_shallow_dent(name):
    plain = load_sensor(name)
    source = replace(plain, optics=replace(plain.optics, shadow=0.0, blur_px=0.0))
    rows, cols = source.camera.shape
    height = 0.3 * bump(rows, cols, 0.5 * rows, 0.5 * cols, 0.25 * rows)
    at = gel_network_input.make_grid((rows, cols))
    touched, still = optics.render(source, height, seed=None), optics.render_reference(source)
    of = seen(source, touched, still, height)
    fields = gel_network_input.compute_channels(of)
    want = at.resample_to_grid(height) / (source.pixel_mm * at.pixels_per_cell)
    gy, gx = np.gradient(want)
    shares = [
        float((slope * true).sum() / (true * true).sum()) for slope, true in ((of.slopes[0], gx), (of.slopes[1], gy))
    ]
    assert shares == pytest.approx([1.0, 1.0], abs=0.1)
    for slope, true in ((fields[6], gx), (fields[7], gy)):
        assert float(np.corrcoef(slope.ravel(), true.ravel())[0, 1]) > 0.95


def test_steep_slopes_are_more_accurate_than_with_a_linear_light():
    mini = load_sensor("gelsight_mini")
    source = replace(mini, optics=replace(mini.optics, blur_px=0.0))
    height = 1.4 * bump(240, 320, 120, 160, 45)
    at, light = gel_network_input.make_grid((240, 320)), gel_network_input.describe_light(source)
    of = seen(source, optics.render(source, height, seed=None), optics.render_reference(source))
    want = np.gradient(at.resample_to_grid(height) / (source.pixel_mm * at.pixels_per_cell))[1]
    linear = gel_network_input._sum_colours(light.inverse[0], gel_network_input._split_colours(of.image - of.reference))
    assert np.abs(of.slopes[0] - want).mean() < 0.8 * np.abs(linear - want).mean()


@pytest.mark.parametrize("name", ["gelsight_mini", "digit"])
def test_the_physical_surface_and_its_slopes_are_channels(name):
    source = load_sensor(name)
    rows, cols = source.camera.shape
    height = bump(rows, cols, 0.4 * rows, 0.6 * cols, 0.2 * rows)
    still = optics.render_reference(source)
    of = seen(source, still, still, height)
    fields, deep = gel_network_input.compute_channels(of), gel_network_input.compute_depth_px(of)
    at = gel_network_input.make_grid((rows, cols))
    want = at.resample_to_grid(height) / (source.pixel_mm * at.pixels_per_cell)
    assert 0.8 * want.max() < deep <= want.max()
    assert fields[gel_network_input.LOG_DEPTH_CHANNEL, 0, 0] == pytest.approx(np.log(deep / 4))
    np.testing.assert_allclose(deep * fields[gel_network_input.SURFACE_CHANNEL], want, atol=1e-4)
    np.testing.assert_allclose(deep * fields[8:10] / 8, np.gradient(want)[::-1], atol=1e-4)
    assert fields[gel_network_input.CONTACT_CHANNEL].mean() == pytest.approx((height > 0.1).mean(), abs=0.01)


def test_a_portrait_sensor_is_transposed_with_its_light():
    digit = load_sensor("digit").optics
    turned = gel_network_input._swap_axes(digit)
    assert gel_network_input._swap_axes(turned) == digit
    assert [led.azimuth_deg for led in turned.leds] == [(90 - led.azimuth_deg) % 360 for led in digit.leds]


def test_the_channels_are_free_of_units_of_length():
    """A sensor twice as large in every way gives the same fields."""
    mini = load_sensor("gelsight_mini")
    c = mini.camera
    large = mini.with_camera(
        Camera(rows=c.rows, cols=c.cols, fx_px=0.5 * c.fx_px, fy_px=0.5 * c.fy_px, cx_px=c.cx_px, cy_px=c.cy_px)
    )
    height, found = 0.3 * bump(240, 320, 120, 160, 40), []
    for source, surface in ((mini, height), (large, 2 * height)):
        shown = optics.render(source, surface, seed=None), optics.render_reference(source)
        of = seen(source, *shown, surface)
        found.append(gel_network_input.compute_channels(of)[: gel_network_input.CONTACT_CHANNEL])
    np.testing.assert_allclose(found[0], found[1], atol=0.08)  # two grey levels


def test_a_touch_twice_as_deep_in_half_the_light_differs_in_the_log_depth_only():
    rng, height = np.random.default_rng(1), bump(120, 160, 60, 80, 25)
    change, slopes = rng.normal(0, 1, (120, 160, 3)) * height[..., None], rng.normal(0, 1, (2, 120, 160)) * height
    found = []
    for light, deep in ((1.0, 1.0), (0.5, 2.0)):
        still = np.full((120, 160, 3), light * 90.0, np.float32)
        of = gel_network_input.NetworkInput(
            image=np.asarray(still + 40 * light * change, np.float32), reference=still,
            slopes=np.asarray(light * slopes, np.float32), physical_px=3 * deep * height,
            physical_contact=(height > 0.3).astype(np.float32),
        )  # fmt: skip
        found.append(gel_network_input.compute_channels(of))
    steep = gel_network_input.LOG_DEPTH_CHANNEL
    assert found[1][steep] - found[0][steep] == pytest.approx(np.log(2), abs=1e-4)
    np.testing.assert_allclose(np.delete(found[0], steep, 0), np.delete(found[1], steep, 0), atol=1e-4)


def test_a_dark_reference_gives_finite_channels():
    source = load_sensor("gelsight_mini")
    still = optics.render_reference(source)
    assert np.isfinite(gel_network_input.compute_channels(seen(source, still, still - 300.0))).all()
