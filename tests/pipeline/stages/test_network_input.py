"""What the network that reads gels looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.camera import Camera
from pipeline.physics import optics
from pipeline.sensors.spec import sensor
from pipeline.stages.depth import network_input
from pipeline.stages.depth.poisson import integrate


def bump(rows, cols, row, col, width):
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    return np.exp(-((x - col) ** 2 + (y - row) ** 2) / width**2).astype(np.float32)


@pytest.mark.parametrize("shape", [(240, 320), (320, 240), (320, 427), (68, 90), (1280, 1708), (128, 128), (100, 400)])
def test_a_field_comes_back_where_it_was(shape):
    at = network_input.frame(shape)
    rows, cols = shape
    there = bump(rows, cols, 0.4 * rows, 0.6 * cols, 0.2 * min(shape))
    back = at.large(at.small(there[..., None].repeat(3, axis=2))[..., 0])
    assert back.shape == shape
    assert np.abs(back - there).max() < 0.05
    assert at.pixels == pytest.approx(max(max(shape) / 160, min(shape) / 120), rel=0.02)


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "gelslim_dotless"])
def test_the_described_light_gives_the_slopes_of_a_shallow_dent(name):
    plain = sensor(name)
    source = replace(plain, optics=replace(plain.optics, shadow=0.0, blur_px=0.0))
    rows, cols = source.camera.shape
    height = 0.3 * bump(rows, cols, 0.5 * rows, 0.5 * cols, 0.25 * rows)
    at = network_input.frame((rows, cols))
    touched, still = optics.render(source, height, seed=None), optics.untouched(source)
    fields = network_input.fields(at.small(touched), at.small(still), network_input.light_of(source))
    want = at.small(height[..., None].repeat(3, axis=2))[..., 0] / (source.pixel_mm * at.pixels)
    gy, gx = np.gradient(want)
    for slope, true in ((fields[9], gx), (fields[10], gy)):
        assert float((slope * true).sum() / (true * true).sum()) == pytest.approx(1.0, abs=0.1)
    surface = 8 * fields[11]
    assert np.corrcoef(surface.ravel(), want.ravel())[0, 1] > 0.97


def test_steep_slopes_are_told_better_than_a_linear_light_would():
    mini = sensor("gelsight_mini")
    source = replace(mini, optics=replace(mini.optics, blur_px=0.0))
    height = 1.4 * bump(240, 320, 120, 160, 45)
    at = network_input.frame((240, 320))
    touched, still = at.small(optics.render(source, height, seed=None)), at.small(optics.untouched(source))
    light = network_input.light_of(source)
    want = np.gradient(at.small(height[..., None].repeat(3, axis=2))[..., 0] / (source.pixel_mm * at.pixels))[1]
    change = np.ascontiguousarray((touched - still).transpose(2, 0, 1))
    linear, found = network_input._summed(light.inverse[0], change), network_input.fields(touched, still, light)[9]
    assert np.abs(found - want).mean() < 0.8 * np.abs(linear - want).mean()


def test_the_surface_of_the_slopes_is_that_of_the_exact_integration():
    gx, gy = np.random.default_rng(0).normal(size=(2, 120, 160)).astype(np.float32)
    np.testing.assert_allclose(network_input._surface(gx, gy), integrate(gx, gy, 1.0), atol=1e-4)


def test_nothing_depends_on_a_unit_of_length():
    """A sensor twice as large in every way gives the same fields."""
    mini = sensor("gelsight_mini")
    c = mini.camera
    large = mini.seen_through(
        Camera(rows=c.rows, cols=c.cols, fx_px=0.5 * c.fx_px, fy_px=0.5 * c.fy_px, cx_px=c.cx_px, cy_px=c.cy_px)
    )
    height = 0.3 * bump(240, 320, 120, 160, 40)
    at, found = network_input.frame((240, 320)), []
    for source, surface in ((mini, height), (large, 2 * height)):
        small = at.small(optics.render(source, surface, seed=None)), at.small(optics.untouched(source))
        found.append(network_input.fields(*small, network_input.light_of(source)))
    np.testing.assert_allclose(found[0], found[1], atol=0.03)


def test_without_a_described_light_there_are_no_slopes():
    picture = np.full((120, 160, 3), 90, np.float32)
    fields = network_input.fields(picture + 5, picture, None)
    assert not fields[9:12].any()
    np.testing.assert_allclose(fields[0:3], 5 / 40)
