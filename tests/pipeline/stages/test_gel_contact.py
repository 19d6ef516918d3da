"""Contact of a gel by the pressure that explains its surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.metrics.stage_metrics import iou
from pipeline.physics import gel
from pipeline.sensors.parts import Gel
from pipeline.stages.depth.gel.contact import MeasuredSurface, detect_contact, press_surface
from pipeline.stages.depth.gel.contact_settings import CONTACT

PAD, PIXEL_MM = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48), 0.1
ROWS, COLS = 96, 128
MARGIN = 20  # pixels of the pad beyond the view
LEAST_MM = 0.02


def press(height_mm):
    """(indentation, contact, force in N) of the view, under an object of this height of (x, y, distance) in mm."""
    y, x = np.mgrid[-MARGIN : ROWS + MARGIN, -MARGIN : COLS + MARGIN] - np.array([47.5, 63.5])[:, None, None]
    x, y = x * PIXEL_MM, y * PIXEL_MM
    pressed = gel.press_gel(PAD, PIXEL_MM, height_mm(x, y, np.hypot(x, y)))
    view = (slice(MARGIN, MARGIN + ROWS), slice(MARGIN, MARGIN + COLS))
    return pressed.indentation_mm[view], pressed.contact[view], pressed.force_n


def ball(x, y, radius_mm, depth_mm):
    return depth_mm - (x * x + y * y) / (2 * radius_mm)


def box(x, y, half_mm, depth_mm):
    return np.where(np.maximum(abs(x), abs(y)) < half_mm, depth_mm, -1.0)


def measure(surface_mm, changed=None):
    shape = surface_mm.shape
    if changed is None:
        changed = np.ones(shape, np.bool_)
    return MeasuredSurface(
        surface_mm=np.ascontiguousarray(surface_mm, np.float32), changed=np.ascontiguousarray(changed),
        weight=np.ascontiguousarray(changed, np.float32), rows=slice(0, shape[0]), cols=slice(0, shape[1]), shape=shape,
        pixel_mm=PIXEL_MM, gel=PAD,
    )  # fmt: skip


def explain(surface_mm, changed=None):
    measured = measure(surface_mm, changed)
    region = detect_contact(measured, CONTACT, CONTACT.contact_share)
    return press_surface(measured, region, region.contact, CONTACT, LEAST_MM)


@pytest.mark.parametrize(
    ("height_mm", "least"),
    [
        (lambda x, y, r: ball(x, y, 4.0, 0.5), 0.8),
        (lambda x, y, r: ball(x, y, 60.0, 0.15), 0.65),  # large and smooth: its pressure falls slowly
        (lambda x, y, r: 0.8 - 0.6 * r, 0.68),  # a cone, whose pressure is infinite at its tip
        (lambda x, y, r: box(x, y, 1.5, 0.4), 0.9),  # a flat punch, whose inside shows no slopes
        (lambda x, y, r: box(x + 4.0, y, 3.5, 0.4), 0.9),  # cut by the border
        (lambda x, y, r: np.where(abs(y) < 3.0, 0.4, -1.0), 0.9),  # from border to border
        (lambda x, y, r: np.where(abs(x) < 5.5, 0.5, -1.0), 0.95),  # all of the view but two strips
        (lambda x, y, r: np.maximum(ball(x + 3.0, y, 3.0, 0.5), ball(x - 3.0, y, 3.0, 0.3)), 0.8),  # two contacts
        (lambda x, y, r: np.where(abs(r - 2.5) < 0.5, 0.4, -1.0), 0.85),  # a ring, with gel inside
    ],
    ids=["ball", "large ball", "cone", "punch", "cut punch", "bar", "wide bar", "two balls", "ring"],
)
def test_contact_and_surface_are_those_that_mechanics_made(height_mm, least):
    surface, contact, _ = press(height_mm)
    found = explain(surface + 0.3)  # the level of a surface that was integrated from slopes is not known
    assert iou(found.contact, contact) > least
    away = np.abs(found.compute_indentation(found.contact) - surface)
    assert away[contact].mean() < 0.15 * surface.max()
    assert away[~contact].mean() < 0.15 * surface.max()


@pytest.mark.parametrize("radius_mm", [3.0, 10.0])
def test_pressure_gives_the_force(radius_mm):
    surface, _, force_n = press(lambda x, y, r: ball(x, y, radius_mm, 0.3))
    assert explain(surface).force_n == pytest.approx(force_n, rel=0.1)


@settings(max_examples=10, deadline=None)
@given(st.floats(0.2, 4.0))
def test_a_surface_that_is_twice_as_deep_has_the_same_contact(factor):
    surface, _, _ = press(lambda x, y, r: ball(x, y, 4.0, 0.3))
    scaled = replace(CONTACT, price_min=0.0, pressure_min=0.0)
    one, more = (
        detect_contact(measure(part), scaled, CONTACT.contact_share).contact for part in (surface, surface * factor)
    )
    assert iou(one, more) > 0.99


def test_a_mirrored_surface_has_the_mirrored_contact():
    surface, _, _ = press(lambda x, y, r: np.maximum(ball(x + 2.0, y - 1.0, 3.0, 0.4), box(x - 3.0, y, 1.0, 0.3)))
    one = explain(surface)
    for flip in (np.fliplr, np.flipud):
        other = explain(flip(surface))
        assert iou(flip(other.contact), one.contact) > 0.99
        assert np.abs(flip(other.measured_mm) - one.measured_mm).max() < 1e-3


def test_where_the_image_is_as_at_rest_the_surface_is_the_mechanical_one_without_a_step():
    surface, contact, _ = press(lambda x, y, r: ball(x, y, 4.0, 0.4))
    y, x = np.mgrid[:ROWS, :COLS]
    changed = np.hypot(y - 47.5, x - 63.5) < 36
    found = explain(np.where(changed, surface, 0.0), changed)
    indentation = found.compute_indentation(found.contact)
    end = (changed[:, 1:] != changed[:, :-1]) & ~contact[:, 1:]
    plain = np.abs(np.diff(surface, axis=1))[end].max()
    assert np.abs(np.diff(indentation, axis=1))[end].max() < plain + 0.002
    assert iou(found.contact, contact) > 0.8


def test_a_broad_error_of_the_light_beside_a_contact_is_none():
    surface, contact, _ = press(lambda x, y, r: ball(x + 2.0, y, 3.0, 0.6))
    y, x = np.mgrid[:ROWS, :COLS] * PIXEL_MM
    lifted = 0.15 * np.exp(-(((x - 12.7) / 2.5) ** 2 + (y / 2.5) ** 2))  # a corner
    assert iou(explain(surface + lifted).contact, contact) > 0.85


def test_a_light_touch_beside_a_firm_one_is_found():
    firm, _, _ = press(lambda x, y, r: ball(x + 3.5, y, 2.0, 0.4))
    light, contact, _ = press(lambda x, y, r: ball(x - 3.5, y, 2.0, 0.15))
    assert explain(firm + light).contact[contact].mean() > 0.6


def test_a_level_surface_is_not_touched():
    assert not explain(np.full((ROWS, COLS), 0.2)).contact.any()


def test_the_pressure_of_the_frame_before_leads_to_the_same_contact():
    before, now = (press(lambda x, y, r, d=depth_mm: ball(x, y, 4.0, d))[0] for depth_mm in (0.3, 0.35))
    start = detect_contact(measure(before), CONTACT, CONTACT.contact_share).blobs
    cold, warm = (detect_contact(measure(now), CONTACT, CONTACT.contact_share, of) for of in (None, start))
    assert iou(cold.contact, warm.contact) > 0.97
