import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.physics import gel
from pipeline.sensors.parts import Gel
from pipeline.sensors.spec import load_sensor

HALF_SPACE = Gel(thickness_mm=math.inf, youngs_kpa=120.0, poisson=0.48)
PAD = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)
PIXEL_MM = 0.06
RADIUS_MM = 4.0
SURFACE_MM = 3e-4  # a third of a micrometre: three times the solver's tolerance
EFFECTIVE_KPA = 120.0 / (1 - 0.48**2)


def radius_mm(shape, row=None, col=None):
    row, col = ((n - 1) / 2 if at is None else at for n, at in zip(shape, (row, col), strict=True))
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(y - row, x - col) * PIXEL_MM


def ball(shape, depth_mm, **at):
    return depth_mm - radius_mm(shape, **at) ** 2 / (2 * RADIUS_MM)  # Hertz' paraboloid


@pytest.mark.parametrize("overlap_mm", [1e-45, 1e-40, 1e-30])
def test_overlaps_below_an_atom_are_zero(overlap_mm):
    pressed = gel.press_gel(PAD, PIXEL_MM, np.full((60, 80), overlap_mm))
    assert not pressed.contact.any()
    assert not pressed.indentation_mm.any()
    held = gel.relax_gel(PAD, PIXEL_MM, np.full((60, 80), overlap_mm), np.ones((60, 80), np.bool_))
    assert not held.pressure_kpa.any()


def test_a_ball_on_a_half_space_follows_hertz():
    shape = (181, 201)
    depth = 0.5
    pressed = gel.press_gel(HALF_SPACE, PIXEL_MM, ball(shape, depth))
    a = math.sqrt(RADIUS_MM * depth)
    r = radius_mm(shape)
    outside = np.maximum(r, a * (1 + 1e-9))
    free = ((2 * a * a - outside**2) * np.arcsin(a / outside) + a * np.sqrt(outside**2 - a * a)) / (
        math.pi * RADIUS_MM
    )
    exact = np.where(r < a, ball(shape, depth), free)
    force_n = 4 / 3 * EFFECTIVE_KPA * math.sqrt(RADIUS_MM) * depth**1.5 * 1e-3
    assert pressed.converged
    assert math.sqrt(pressed.contact.sum() / math.pi) * PIXEL_MM == pytest.approx(a, rel=0.01)
    assert pressed.force_n == pytest.approx(force_n, rel=0.005)
    # issue: at most 0.1 um rms
    assert np.sqrt(((pressed.indentation_mm - exact) ** 2).mean()) < 1e-4


def test_a_flat_punch_needs_the_force_of_sneddon():
    shape = (161, 161)
    a = 2.0
    overlap = np.where(radius_mm(shape) < a, 0.3, -np.inf)
    pressed = gel.press_gel(HALF_SPACE, PIXEL_MM, overlap)
    area_radius = math.sqrt((radius_mm(shape) < a).sum() / math.pi) * PIXEL_MM
    assert pressed.force_n == pytest.approx(2 * EFFECTIVE_KPA * area_radius * 0.3 * 1e-3, rel=0.01)


def test_a_cone_needs_the_force_of_sneddon():
    shape = (181, 181)
    depth = 0.6
    slope = 0.25
    pressed = gel.press_gel(HALF_SPACE, PIXEL_MM, depth - slope * radius_mm(shape))
    assert pressed.force_n == pytest.approx(
        2 / math.pi * EFFECTIVE_KPA * depth**2 / slope * 1e-3, rel=0.01
    )


def test_a_thick_pad_is_a_half_space_and_a_thin_one_is_stiffer_and_touches_more():
    overlap = ball((101, 121), 0.05)
    half_space, thick, thin = (
        gel.press_gel(g, PIXEL_MM, overlap)
        for g in (HALF_SPACE, Gel(thickness_mm=12.0, youngs_kpa=120.0, poisson=0.48), PAD)
    )
    assert thick.force_n == pytest.approx(
        half_space.force_n, rel=0.08
    )  # a / t = 0.04, and the first correction is about 1.1 a / t
    assert thin.force_n > 1.15 * half_space.force_n
    assert thin.contact.sum() > half_space.contact.sum()


@given(seed=st.integers(0, 10**6), depth=st.floats(1e-3, 10.0), share=st.floats(0.01, 1.0))
@settings(max_examples=20)
def test_rough_and_ragged_objects_converge_too(seed, depth, share):
    rng = np.random.default_rng(seed)
    overlap = np.where(rng.random((50, 60)) < share, depth * rng.random((50, 60)), -np.inf)
    pressed = gel.press_gel(PAD, PIXEL_MM, overlap, tolerance_mm=1e-4 * max(1.0, depth))
    assert pressed.converged
    assert np.isfinite(pressed.indentation_mm).all()


def test_a_mirrored_press_gives_the_mirrored_surface():
    overlap = ball((80, 100), 0.4, row=30, col=37)
    one = gel.press_gel(PAD, PIXEL_MM, overlap)
    other = gel.press_gel(PAD, PIXEL_MM, overlap[:, ::-1])
    assert np.abs(one.indentation_mm[:, ::-1] - other.indentation_mm).max() < SURFACE_MM


def test_twice_the_resolution_gives_the_same_force():
    coarse = gel.press_gel(PAD, 2 * PIXEL_MM, ball((160, 160), 0.4)[::2, ::2])
    fine = gel.press_gel(PAD, PIXEL_MM, ball((160, 160), 0.4))
    assert coarse.force_n == pytest.approx(fine.force_n, rel=0.01)


def test_the_size_of_the_image_around_a_contact_does_not_matter():
    wide = ball((200, 220), 0.3)
    narrow = wide[60:140, 70:150]
    cut = gel.press_gel(PAD, PIXEL_MM, wide).indentation_mm[60:140, 70:150]
    assert np.abs(cut - gel.press_gel(PAD, PIXEL_MM, narrow).indentation_mm).max() < SURFACE_MM


@pytest.mark.parametrize(
    "overlap",
    [
        np.full((40, 50), -np.inf),
        np.full((40, 50), np.nan),
        np.full((40, 50), -0.1),
        np.zeros((40, 50)),
    ],
    ids=["nothing", "gaps", "above", "just at the surface"],
)
def test_an_object_above_the_gel_changes_nothing(overlap):
    pressed = gel.press_gel(PAD, PIXEL_MM, overlap)
    assert not pressed.indentation_mm.any()
    assert not pressed.contact.any()
    assert pressed.force_n == 0.0


@pytest.mark.parametrize("depth", [1e-6, 0.5, 50.0])
def test_a_plate_over_the_whole_pad_and_extreme_depths_stay_finite(depth):
    pressed = gel.press_gel(PAD, PIXEL_MM, np.full((60, 70), depth))
    assert np.isfinite(pressed.indentation_mm).all()
    assert pressed.converged
    assert pressed.contact.mean() > 0.95


def test_a_single_pixel_can_press():
    overlap = np.full((40, 50), -np.inf)
    overlap[0, 49] = 0.2
    assert gel.press_gel(PAD, PIXEL_MM, overlap).indentation_mm[0, 49] == pytest.approx(
        0.2, abs=SURFACE_MM
    )


def test_a_solve_out_of_steps_has_not_converged():
    assert not gel.press_gel(PAD, PIXEL_MM, ball((80, 90), 0.4), max_steps=2).converged


def test_the_true_contact_relaxes_to_the_true_surface():
    spec = load_sensor("digit")
    assert spec.gel is not None
    pressed = gel.press_gel(spec.gel, PIXEL_MM, ball((100, 120), 0.5))
    followed = gel.relax_gel(
        spec.gel,
        PIXEL_MM,
        np.where(pressed.contact, pressed.indentation_mm, np.nan),
        pressed.contact,
    )
    assert followed.converged
    assert np.abs(followed.indentation_mm - pressed.indentation_mm).max() < SURFACE_MM
