"""What the network that reads gels looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.sensors.spec import sensor
from pipeline.stages.depth import network_input


def bump(rows, cols, row, col, width):
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    return np.exp(-((x - col) ** 2 + (y - row) ** 2) / width**2).astype(np.float32)


@pytest.mark.parametrize("shape", [(240, 320), (320, 240), (320, 427), (68, 90), (1280, 1708), (128, 128), (100, 400)])
def test_a_field_comes_back_where_it_was(shape):
    at = network_input.frame(shape)
    rows, cols = shape
    there = bump(rows, cols, 0.4 * rows, 0.6 * cols, 0.2 * min(shape))
    back = at.large(at.small(there))
    assert back.shape == shape
    assert np.abs(back - there).max() < 0.05
    assert at.pixels == pytest.approx(max(max(shape) / 160, min(shape) / 120), rel=0.02)


def seen(source, touched, still, height=None):
    height = np.zeros(source.camera.shape, np.float32) if height is None else height
    light = network_input.light_of(source)
    return network_input.seen(touched, still.astype(np.float32), height, height > 0.1, source, light)


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim_dotless"])
def test_the_described_light_gives_the_slopes_of_a_shallow_dent(name):
    plain = sensor(name)
    source = replace(plain, optics=replace(plain.optics, shadow=0.0, blur_px=0.0))
    rows, cols = source.camera.shape
    height = 0.3 * bump(rows, cols, 0.5 * rows, 0.5 * cols, 0.25 * rows)
    at = network_input.frame((rows, cols))
    touched, still = optics.render(source, height, seed=None), optics.untouched(source)
    of = seen(source, touched, still, height)
    fields = network_input.fields(of)
    want = at.small(height) / (source.pixel_mm * at.pixels)
    gy, gx = np.gradient(want)
    shares = [
        float((slope * true).sum() / (true * true).sum()) for slope, true in ((of.slopes[0], gx), (of.slopes[1], gy))
    ]
    assert shares == pytest.approx([1.0, 1.0], abs=0.1)
    for slope, true in ((fields[6], gx), (fields[7], gy)):
        assert float(np.corrcoef(slope.ravel(), true.ravel())[0, 1]) > 0.95


def test_steep_slopes_are_told_better_than_a_linear_light_would():
    mini = sensor("gelsight_mini")
    source = replace(mini, optics=replace(mini.optics, blur_px=0.0))
    height = 1.4 * bump(240, 320, 120, 160, 45)
    at, light = network_input.frame((240, 320)), network_input.light_of(source)
    of = seen(source, optics.render(source, height, seed=None), optics.untouched(source))
    want = np.gradient(at.small(height) / (source.pixel_mm * at.pixels))[1]
    linear = network_input._summed(light.inverse[0], network_input._planes(of.touched - of.untouched))
    assert np.abs(of.slopes[0] - want).mean() < 0.8 * np.abs(linear - want).mean()


@pytest.mark.parametrize("name", ["gelsight_mini", "digit"])
def test_the_physical_answer_is_among_the_fields_with_its_slopes(name):
    source = sensor(name)
    rows, cols = source.camera.shape
    height = bump(rows, cols, 0.4 * rows, 0.6 * cols, 0.2 * rows)
    still = optics.untouched(source)
    of = seen(source, still, still, height)
    fields, deep = network_input.fields(of), network_input.depth_px(of)
    at = network_input.frame((rows, cols))
    want = at.small(height) / (source.pixel_mm * at.pixels)
    assert 0.8 * want.max() < deep <= want.max()
    assert fields[network_input.STEEP, 0, 0] == pytest.approx(np.log(deep / 4))
    np.testing.assert_allclose(deep * fields[network_input.SURFACE], want, atol=1e-4)
    np.testing.assert_allclose(deep * fields[8:10] / 8, np.gradient(want)[::-1], atol=1e-4)
    assert fields[network_input.PRESSED].mean() == pytest.approx((height > 0.1).mean(), abs=0.01)


def test_a_portrait_sensor_lies_on_its_side_with_its_light():
    digit = sensor("digit").optics
    turned = network_input._mirrored(digit)
    assert network_input._mirrored(turned) == digit
    assert [led.azimuth_deg for led in turned.leds] == [(90 - led.azimuth_deg) % 360 for led in digit.leds]


def test_nothing_depends_on_a_unit_of_length():
    """A sensor twice as large in every way gives the same fields."""
    mini = sensor("gelsight_mini")
    c = mini.camera
    large = mini.seen_through(
        Camera(rows=c.rows, cols=c.cols, fx_px=0.5 * c.fx_px, fy_px=0.5 * c.fy_px, cx_px=c.cx_px, cy_px=c.cy_px)
    )
    height, found = 0.3 * bump(240, 320, 120, 160, 40), []
    for source, surface in ((mini, height), (large, 2 * height)):
        shown = optics.render(source, surface, seed=None), optics.untouched(source)
        of = seen(source, *shown, surface)
        found.append(network_input.fields(of)[: network_input.PRESSED])
    np.testing.assert_allclose(found[0], found[1], atol=0.08)  # two grey levels


def test_a_touch_twice_as_deep_in_half_the_light_looks_alike_but_for_how_steep_it_is():
    rng, height = np.random.default_rng(1), bump(120, 160, 60, 80, 25)
    change, slopes = rng.normal(0, 1, (120, 160, 3)) * height[..., None], rng.normal(0, 1, (2, 120, 160)) * height
    found = []
    for light, deep in ((1.0, 1.0), (0.5, 2.0)):
        still = np.full((120, 160, 3), light * 90.0, np.float32)
        of = network_input.Seen(
            touched=np.asarray(still + 40 * light * change, np.float32), untouched=still,
            slopes=np.asarray(light * slopes, np.float32), physical_px=3 * deep * height,
            pressed=(height > 0.3).astype(np.float32),
        )  # fmt: skip
        found.append(network_input.fields(of))
    steep = network_input.STEEP
    assert found[1][steep] - found[0][steep] == pytest.approx(np.log(2), abs=1e-4)
    np.testing.assert_allclose(np.delete(found[0], steep, 0), np.delete(found[1], steep, 0), atol=1e-4)


@pytest.mark.parametrize(("row", "col", "radius"), [(60, 80, 9), (2, 158, 6), (60, 80, 90), (119, 0, 0.5)])
def test_the_box_holds_the_contact_and_what_is_around_it(row, col, radius):
    y, x = np.mgrid[:120, :160]
    pressed = ((y - row) ** 2 + (x - col) ** 2 <= radius**2).astype(np.float32)
    nothing = np.zeros((120, 160, 3), np.float32)
    of = network_input.Seen(
        touched=nothing,
        untouched=nothing,
        slopes=np.zeros((2, 120, 160), np.float32),
        physical_px=pressed,
        pressed=pressed,
    )
    rows, cols = network_input.box(of)
    for part, middle, most in ((rows, row, 120), (cols, col, 160)):
        assert 0 <= part.start <= max(0, middle - radius - 24)
        assert most >= part.stop >= min(most, middle + radius + 24)
        assert (part.stop - part.start) % 16 == 0 or part.stop - part.start == most
    fields = network_input.fields(of, (rows, cols))
    whole = network_input.fields(of)[:, rows, cols]
    at = [network_input.SURFACE, network_input.PRESSED, network_input.STEEP, 14, 15]
    np.testing.assert_array_equal(fields[at], whole[at])


def test_drift_that_took_all_light_away_leaves_numbers():
    source = sensor("gelsight_mini")
    still = optics.untouched(source)
    assert np.isfinite(network_input.fields(seen(source, still, still - 300.0))).all()
