"""Rest, faces and the far field of a pressed gel."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest

from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import Gel, load_sensor
from pipeline.stages.depth import change_detection, rest_level
from pipeline.stages.depth.gel import contact as gel_contact
from pipeline.stages.depth.gel.settings import CONTACT
from pipeline.stages.depth.photometric import DepthParams, estimate_depth

GEL = Gel(thickness_mm=2.0, youngs_kpa=120.0, poisson=0.48)
PIXEL_MM = 0.06
FACE_IOU = 0.9


@lru_cache
def pressed_box(name, share):
    """A level face, `share` of the view's shorter side wide, pressed in by 0.5 mm: (sensor,
    frame, truth).
    """
    source = load_sensor(name)
    half = 0.5 * share * min(source.camera.shape) * source.pixel_mm
    box = shapes.make_chamfered_prism(
        [(-half, -half), (half, -half), (half, half), (-half, half)], 8.0, 0.0, "box"
    )
    touch = simulate_press(
        box, rigid.translation(0.0, 0.0, -0.5 - box.vertices_mm[:, 2].min()), source, seed=1
    )
    return (
        source,
        TactileFrame(sensor=name, image=touch.image, reference=optics.render_reference(source)),
        touch.truth,
    )


@pytest.mark.parametrize(
    ("name", "share"),
    [("gelsight_mini", 0.65), ("gelslim", 1.0), ("digit", 1.2), ("gelsight_mini", 1.2)],
)
def test_a_face_is_touched_all_over_whether_its_rim_is_seen_or_cut_off(name, share):
    source, frame, truth = pressed_box(name, share)
    found = estimate_depth(frame, source, None, DepthParams())
    assert (found.contact & truth.contact).sum() / (found.contact | truth.contact).sum() > FACE_IOU


def test_a_contact_that_fills_the_view_is_said_to():
    source, frame, truth = pressed_box("gelsight_mini", 1.25)
    assert truth.contact.mean() > 0.9
    assert any(
        "fills the view" in note
        for note in estimate_depth(frame, source, None, DepthParams()).notes
    )


@pytest.mark.parametrize("lifted_mm", [0.3, 0.42])
def test_gel_that_the_pictures_border_cuts_is_no_face_because_one_flank_was_read_too_flat(
    lifted_mm,
):
    x = np.arange(220)
    bar = 0.5 * np.maximum(1 - ((x - 110) / 16.0) ** 2, 0)
    lifted = lifted_mm / (1 + np.exp(-(x - 118) / 3.0))
    surface = np.tile(np.maximum(bar, lifted), (160, 1)).astype(np.float32)
    found = rest_level.level_surface(surface, np.tile(bar > 0, (160, 1)), PIXEL_MM, GEL, CONTACT)
    assert not found.face_interior.any()
    assert np.abs(found.surface_mm[:, -20:]).max() < 0.05


def test_a_faint_ridge_beside_a_deep_dent_encloses_no_face():
    x = np.arange(300)
    dent = 0.8 * np.maximum(1 - ((x - 60) / 16.0) ** 2, 0)
    ridge = 0.12 / (1 + np.exp(-(x - 170) / 2.0))
    surface = np.tile(dent + ridge, (160, 1)).astype(np.float32)
    pressed = np.tile((dent > 0) | (np.abs(x - 175) < 5), (160, 1))
    assert not rest_level.level_surface(
        surface, pressed, PIXEL_MM, GEL, CONTACT
    ).face_interior.any()


def test_gel_beyond_a_dent_is_brought_back_to_rest_on_either_side():
    x = np.arange(220)
    bar = 0.5 * np.maximum(1 - ((x - 110) / 16.0) ** 2, 0)
    surface = np.tile(bar + 0.25 / (1 + np.exp(-(x - 118) / 3.0)), (160, 1)).astype(
        np.float32
    )  # one flank read too flat
    found = rest_level.level_surface(surface, np.tile(bar > 0, (160, 1)), PIXEL_MM, GEL, CONTACT)
    assert np.abs(found.surface_mm[:, :20]).max() < 0.03
    assert np.abs(found.surface_mm[:, -20:]).max() < 0.03
    assert not found.face_interior.any()


@pytest.mark.parametrize("lifted_mm", [0.2, 0.28])
def test_all_of_a_third_of_the_gel_that_lies_too_high_is_brought_to_rest(lifted_mm):
    x = np.arange(220)
    bar = 0.8 * np.maximum(1 - ((x - 110) / 16.0) ** 2, 0)
    lifted = lifted_mm / (1 + np.exp(-(x - 118) / 3.0))
    found = rest_level.level_surface(
        np.tile(bar + lifted, (160, 1)).astype(np.float32),
        np.tile(bar > 0, (160, 1)),
        PIXEL_MM,
        GEL,
        CONTACT,
    )
    assert np.abs(found.surface_mm[:, -20:]).max() < 0.05


def test_specks_of_noise_on_gel_that_lies_too_high_enclose_no_face():
    source = load_sensor("gelslim")
    rows, cols = source.camera.shape
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    bar = 0.5 * np.maximum(1 - ((x - 120) / 24.0) ** 2, 0)
    surface = np.maximum(bar, 0.35 / (1 + np.exp(-(x - 132) / 4.0)))
    for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):  # grains of 0.05 mm2
        at = np.hypot(x - 290 - 75 * np.cos(angle), y - 160 - 75 * np.sin(angle))
        surface += 0.02 * np.exp(-((at / 2.5) ** 2))
    whole = change_detection.ImageWindow(
        rows=slice(0, rows),
        cols=slice(0, cols),
        changed=np.ones((rows, cols), np.bool_),
        blend_weight=np.ones((rows, cols), np.float32),
    )
    settled, inside = gel_contact._level_surface(surface, whole, source, source.pixel_mm, CONTACT)
    assert not inside.any()
    assert np.abs(settled[:, -40:]).max() < 0.05


def test_a_light_face_of_which_only_pieces_of_the_rim_are_seen_is_found_all_over():
    source = load_sensor("digit")
    face = shapes.make_shape("square").mesh
    unit = vary_sensor(source, 6)
    touch = simulate_press(
        face, rigid.translation(0.0, 0.0, -0.025 - face.vertices_mm[:, 2].min()), unit, seed=1
    )
    frame = TactileFrame(sensor="digit", image=touch.image, reference=optics.render_reference(unit))
    found = estimate_depth(frame, source, None, DepthParams())
    assert (found.contact & touch.truth.contact).sum() / (
        found.contact | touch.truth.contact
    ).sum() > FACE_IOU


def test_a_patch_as_deep_as_the_rim_around_it_is_the_inside_of_a_face():
    y, x = np.mgrid[:200, :200]
    away = np.maximum(abs(y - 100), abs(x - 100))
    surface = np.clip((70 - away) * 0.05, 0.0, 0.5).astype(np.float32)
    found = rest_level.level_surface(surface, abs(away - 62) < 4, PIXEL_MM, GEL, CONTACT)
    assert found.face_interior[100, 100]
    assert not found.face_interior[4, 4]


def test_rings_are_not_filled():
    y, x = np.mgrid[:200, :200]
    away = np.hypot(y - 100, x - 100)
    surface = (0.4 * np.exp(-(((away - 65) / 6.0) ** 2))).astype(np.float32)
    assert not rest_level.level_surface(
        surface, abs(away - 65) < 5, PIXEL_MM, GEL, CONTACT
    ).face_interior.any()


def measure_distance_mm(truth, source):
    outside = (~truth.contact).astype(np.uint8)
    return cv2.distanceTransform(outside, cv2.DIST_L2, 5) * source.pixel_mm


def test_the_far_field_is_what_a_pressed_layer_does():
    source, _, truth = pressed_box("gelsight_mini", 0.35)
    around, _ = rest_level.compute_far_field(
        truth.indentation_mm, truth.contact, source.pixel_mm, source.gel, CONTACT
    )
    away = measure_distance_mm(truth, source)
    outside = (away > 1.0) & (away < 4.0)
    assert truth.indentation_mm[outside].min() < -0.03  # a bulge
    assert np.abs(around - truth.indentation_mm)[outside].mean() < 0.01


def test_the_surface_has_no_step_where_the_part_that_was_looked_at_ends():
    source, frame, truth = pressed_box("gelsight_mini", 0.2)
    found = estimate_depth(frame, source, None, DepthParams()).indentation_mm
    beyond = measure_distance_mm(truth, source) > 2.0
    for surface, where in ((found, beyond), (found.T, beyond.T)):
        bend_mm = np.abs(np.diff(surface, 2, axis=0))
        assert bend_mm[where[2:] & where[:-2]].max() < 0.002


def test_what_is_looked_at_around_a_touch_ends_in_a_round_line():
    touched = np.zeros((40, 50), np.bool_)
    touched[20, 25] = True
    window = change_detection.grow_to_window(touched, (320, 400), 0.05)
    y, x = np.nonzero(window.changed)
    y = y + window.rows.start - 163.5
    x = x + window.cols.start - 203.5
    edge = [
        np.hypot(x, y)[np.abs(np.arctan2(y, x) - angle) < 0.05].max()
        for angle in np.linspace(-3, 3, 25)
    ]
    assert np.ptp(edge) < 6.0  # 2 mm are 40 px; squares of 8 px would leave 16
    assert (np.diff(np.sort(np.unique(window.blend_weight))) < 0.1).all()
