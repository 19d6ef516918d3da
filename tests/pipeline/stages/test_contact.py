"""Which pressed regions of a gel are a contact."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.ndimage import binary_fill_holes, label

from benchmarks.real_things import circle_of, straight
from pipeline.physics import gel
from pipeline.sensors.parts import Gel
from pipeline.stages.depth.contact import (
    detect_contact,
    detect_membrane_contact,
    fill_holes,
    fill_small_holes,
    remove_weak_specks,
)
from pipeline.stages.depth.gel.settings import CONTACT
from pipeline.stages.metrics.stage_metrics import iou

SHAPE = (60, 80)
PAD = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)
PIXEL_MM = 0.05
LIMITS = {"least_mm": 0.03, "pressure_share": 0.25, "settings": CONTACT}


def press_gel_height(height_mm):
    """A gel under an object whose overlap is this function of (x, y, distance) from the middle,
    and the truth.
    """
    y, x = (np.mgrid[:120, :140] - np.array([59.5, 69.5])[:, None, None]) * PIXEL_MM
    pressed = gel.press_gel(PAD, PIXEL_MM, height_mm(x, y, np.hypot(x, y)))
    return pressed.indentation_mm, pressed.contact


def test_specks_that_hardly_press_are_left_out_beside_what_does():
    pressure = np.zeros(SHAPE, np.float32)
    pressure[20:40, 20:40] = 1.0
    pressure[5, 5] = 0.2
    pressure[5, 50] = 0.6
    found = remove_weak_specks(pressure > 0.1, pressure, 4, 0.5)
    assert found[30, 30]
    assert not found[5, 5]
    assert found[5, 50]  # as a light touch's rim, of which only pieces are seen
    assert np.array_equal(
        remove_weak_specks(pressure > 2.0, pressure, 4, 0.5), np.zeros(SHAPE, np.bool_)
    )


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.booleans()))
def test_what_a_mask_encloses_is_filled(mask):
    assert np.array_equal(fill_holes(mask), binary_fill_holes(mask))


@given(
    arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.booleans()),
    st.integers(0, 9),
)
def test_only_small_holes_are_filled(mask, most):
    holes, n = label(binary_fill_holes(mask) & ~mask)
    small = np.isin(holes, [k for k in range(1, n + 1) if (holes == k).sum() <= most])
    assert np.array_equal(fill_small_holes(mask, most), mask | small)


def test_the_contact_of_a_rough_ball_has_no_stairs():
    """As on a tennis ball: what closes the gaps between its threads must not leave its own
    square shape.
    """
    height_mm, _ = press_gel_height(lambda x, y, r: 0.5 - r * r / 12.0)
    rough = np.random.default_rng(5).normal(0.0, 1.0, height_mm.shape).astype(np.float32)
    rough = cv2.GaussianBlur(rough, (0, 0), 3.0)
    contact = detect_contact(height_mm + 0.05 * height_mm * rough / rough.std(), PIXEL_MM, **LIMITS)
    assert straight(contact) - circle_of(int(contact.sum())) < 0.1


@pytest.mark.parametrize(
    ("height_mm", "least"),
    [
        (lambda x, y, r: 0.8 - 0.6 * r, 0.72),  # a cone, whose pressure is infinite at its tip
        (lambda x, y, r: 0.5 - r * r / 8.0, 0.80),
        (lambda x, y, r: 0.3 - r * r / 8.0, 0.83),
        # a rod, whose ends are sharp
        (lambda x, y, r: 0.5 - x * x / 4.0 - np.where(abs(y) < 1.8, 0.0, 9.0), 0.83),
        # a face
        (lambda x, y, r: 0.4 - np.where(np.maximum(abs(x), abs(y)) < 1.0, 0.0, 9.0), 0.94),
    ],
    ids=["cone", "ball", "ball lightly", "rod", "face"],
)
def test_the_contact_of_what_mechanics_press_is_found_nearly_to_its_rim(height_mm, least):
    surface, contact = press_gel_height(height_mm)
    assert iou(detect_contact(surface, PIXEL_MM, **LIMITS), contact) > least


def test_gel_that_a_deep_contact_hardly_pulls_along_is_not_touched():
    _, _, r = (
        np.broadcast_to(a, (120, 140))
        for a in (0, 0, np.hypot(*np.mgrid[-60:60, -70:70]) * PIXEL_MM)
    )
    ball = np.maximum(0.9 - r * r / 4.0, 0.0)
    skirt = np.where(r < 2.6, 0.15, 0.0)
    found = detect_contact(np.maximum(ball, skirt).astype(np.float32), PIXEL_MM, **LIMITS)
    assert found[r < 1.2].all()
    assert not found[r > 2.0].any()


def test_a_light_touch_beside_a_firm_one_has_a_peak_of_its_own():
    surface, _ = press_gel_height(lambda x, y, r: 0.5 - (x + 2.0) ** 2 - y * y)
    light, contact = press_gel_height(lambda x, y, r: 0.06 - (x - 2.0) ** 2 / 2.0 - y * y / 2.0)
    found = detect_contact(surface + light, PIXEL_MM, **LIMITS)
    assert found[contact].mean() > 0.5


def test_a_membranes_contact_has_no_holes():
    y, x = np.mgrid[:80, :80]
    r = np.hypot(x - 39.5, y - 39.5)
    surface = np.clip(25.0 - np.abs(r - 15.0) * 2.0, 0.0, 20.0).astype(np.float32)
    found = detect_membrane_contact(surface, least_mm=1.0, pressure_share=0.25, smoothing_px=2.0)
    assert found[39, 39]
    assert not found[0, 0]
