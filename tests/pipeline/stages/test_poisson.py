from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.errors import ShapeError
from pipeline.stages.depth.poisson import (
    Integrator,
    SideBoundaries,
    integrate_slopes,
    solve_weighted_slopes,
)

# what the stage promises; second-order staggering leaves about 7e-4 on this bump
BUMP_TOLERANCE_PX = 1e-3
ROUNDING = 2e-5  # float32 transforms of values of order 1 to 10


def bump(rows: int, cols: int, tilt: float):
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x = x - 0.51 * cols
    y = y - 0.48 * rows
    s = 12.0
    z = 20.0 * np.exp(-(x * x + y * y) / (2 * s * s))
    return (
        z + tilt * x,
        (-x / s**2 * z + tilt).astype(np.float32),
        (-y / s**2 * z).astype(np.float32),
    )


@pytest.mark.parametrize(("boundary", "tilt"), [("free", 0.05), ("flat", 0.0)])
def test_an_analytic_bump_comes_back_within_a_thousandth_of_a_pixel(boundary, tilt):
    z, gx, gy = bump(320, 427, tilt)
    off = integrate_slopes(gx, gy, 1.0, boundary) - z
    off -= off.mean() if boundary == "free" else 0.0
    assert np.sqrt(np.mean(off**2)) < BUMP_TOLERANCE_PX


def test_a_tilted_plane_is_exact_with_a_free_border():
    z = integrate_slopes(
        np.full((31, 46), 0.3, np.float32), np.full((31, 46), -0.2, np.float32), 0.5
    )
    y, x = np.mgrid[:31, :46]
    plane = 0.5 * (0.3 * (x - 22.5) - 0.2 * (y - 15.0))
    assert np.abs(z - plane).max() < ROUNDING


@settings(max_examples=25)
@given(rows=st.integers(1, 40), cols=st.integers(1, 40), seed=st.integers(0, 99))
def test_the_free_integral_is_the_least_squares_one_for_any_size(rows, cols, seed):
    g = np.random.default_rng(seed).normal(size=(2, rows, cols)).astype(np.float32)
    z = integrate_slopes(g[0], g[1], 1.0).astype(np.float64)
    ex = np.diff(z, axis=1) - (g[0, :, 1:] + g[0, :, :-1]) / 2
    ey = np.diff(z, axis=0) - (g[1, 1:] + g[1, :-1]) / 2
    gradient = -np.diff(np.pad(ex, ((0, 0), (1, 1))), axis=1) - np.diff(
        np.pad(ey, ((1, 1), (0, 0))), axis=0
    )
    assert np.abs(gradient).max() < 1e-4  # float32 slopes of order 1, condition about 40^2


KINDS = st.sampled_from(["free", "flat"])


@settings(max_examples=25)
@given(
    sides=st.tuples(KINDS, KINDS, KINDS, KINDS).filter(lambda s: "flat" in s),
    seed=st.integers(0, 99),
)
def test_every_side_may_be_free_or_flat_on_its_own(sides, seed):
    g = np.random.default_rng(seed).normal(size=(2, 9, 13)).astype(np.float32)
    z = integrate_slopes(g[0], g[1], 1.0, SideBoundaries(*sides)).astype(np.float64)
    gradient = np.zeros_like(z)
    for axis, (first, last) in ((1, sides[:2]), (0, sides[2:])):
        along, slope, out = (np.moveaxis(a, axis, 1) for a in (z, g[1 - axis], gradient))
        edges = np.diff(along) - (slope[:, 1:] + slope[:, :-1]) / 2
        out[:, :-1] -= edges
        out[:, 1:] += edges
        # half a pixel outside the surface is zero: counted as a whole step of twice the rise
        if first == "flat":
            out[:, 0] += 2 * along[:, 0] - slope[:, 0]
        if last == "flat":
            out[:, -1] += 2 * along[:, -1] + slope[:, -1]
    assert np.abs(gradient).max() < 1e-4


@pytest.mark.parametrize("sides", [("free",) * 4, ("flat",) * 4, ("free", "flat", "flat", "flat")])
@pytest.mark.parametrize("shape", [(107, 60), (60, 107), (107, 61)])
def test_it_does_not_matter_along_which_axis_the_waves_are_made(shape, sides):
    g = np.random.default_rng(1).normal(size=(2, 2, *shape)).astype(np.float32)
    z = integrate_slopes(g[0], g[1], 1.0, SideBoundaries(*sides))
    left, right, top, bottom = sides
    turned = integrate_slopes(
        g[1].swapaxes(1, 2), g[0].swapaxes(1, 2), 1.0, SideBoundaries(top, bottom, left, right)
    )
    assert np.abs(z - turned.swapaxes(1, 2)).max() < ROUNDING * np.abs(z).max()
    alone = integrate_slopes(g[0, 1], g[1, 1], 1.0, SideBoundaries(*sides))
    assert alone.tobytes() == z[1].tobytes()


@settings(max_examples=20)
@given(seed=st.integers(0, 99), scale=st.floats(0.01, 10.0))
def test_the_integral_is_linear_and_scales_with_the_pixel(seed, scale):
    g = np.random.default_rng(seed).normal(size=(2, 12, 17)).astype(np.float32)
    one = integrate_slopes(g[0], g[1], 1.0, "flat")
    assert np.allclose(
        integrate_slopes(g[0], g[1], scale, "flat"), scale * one, rtol=1e-5, atol=scale * ROUNDING
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_slopes_that_are_not_finite_are_refused(bad):
    g = np.zeros((5, 6), np.float32)
    g[2, 3] = bad
    with pytest.raises(ShapeError, match="not finite"):
        integrate_slopes(g, np.zeros_like(g), 1.0)


def test_slopes_of_different_shapes_are_refused():
    with pytest.raises(ShapeError, match="one shape"):
        integrate_slopes(np.zeros((5, 6), np.float32), np.zeros((6, 5), np.float32), 1.0)


def test_the_result_is_read_only_and_repeats_to_the_byte():
    _, gx, gy = bump(40, 50, 0.0)
    first = integrate_slopes(gx, gy, 0.1, "flat")
    assert not first.flags.writeable
    assert first.tobytes() == integrate_slopes(gx, gy, 0.1, "flat").tobytes()


def test_slopes_that_are_known_less_surely_give_way():
    z, gx, gy = bump(40, 50, 0.0)
    wall = np.zeros(z.shape, np.bool_)
    wall[10:30, 20:24] = True  # seen through from above and below
    seen_x = np.where(wall, 0.2 * gx, gx).astype(np.float32)  # saturated: less than is there
    sure = np.zeros((3, *z.shape), np.float32)
    sure[0] = sure[2] = np.where(wall, 1e-3, 1.0)

    plainly = Integrator(pixel_mm=0.1, sides=SideBoundaries(*4 * ["free"]))
    first = plainly(seen_x, gy)
    found = solve_weighted_slopes(first, (seen_x, gy), sure, 0.1, plainly, 40)
    truth = plainly(gx, gy)
    off = [float(np.ptp(surface - truth)) for surface in (first, found)]
    assert off[1] < 0.1 * off[0]


def test_slopes_that_are_all_as_sure_are_integrated_at_once():
    z, gx, gy = bump(40, 50, 0.0)
    sure = np.zeros((3, *z.shape), np.float32)
    sure[0] = sure[2] = 7.0
    start = np.zeros_like(z, np.float32)
    plainly = Integrator(pixel_mm=0.1, sides=SideBoundaries(*4 * ["free"]))
    found = solve_weighted_slopes(start, (gx, gy), sure, 0.1, plainly, 2)
    truth = plainly(gx, gy)
    assert float(np.abs(found - truth).max()) < 0.02 * float(np.ptp(truth))
