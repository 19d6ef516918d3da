"""Faces on a pressed gel, and the window that is looked at around a touch."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from pipeline.geometry import rigid
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.simulation.variation import vary_sensor
from pipeline.stages.depth import change_detection
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.values.frames import TactileFrame

FACE_IOU = 0.9


@lru_cache
def pressed_box(name, share):
    """A level face, `share` of the view's shorter side wide, pressed in by 0.5 mm: (sensor, frame, truth)."""
    source = load_sensor(name)
    half = 0.5 * share * min(source.camera.shape) * source.pixel_mm
    box = shapes.make_chamfered_prism([(-half, -half), (half, -half), (half, half), (-half, half)], 8.0, 0.0, "box")
    touch = simulate_press(box, rigid.translation(0.0, 0.0, -0.5 - box.vertices_mm[:, 2].min()), source, seed=1)
    return source, TactileFrame(sensor=name, image=touch.image, reference=optics.render_reference(source)), touch.truth


@pytest.mark.parametrize(
    ("name", "share"), [("gelsight_mini", 0.65), ("gelslim", 1.0), ("digit", 1.2), ("gelsight_mini", 1.2)]
)
def test_a_face_is_touched_all_over_whether_its_rim_is_seen_or_cut_off(name, share):
    source, frame, truth = pressed_box(name, share)
    found = estimate_depth(frame, source, None, DepthParams())
    assert (found.contact & truth.contact).sum() / (found.contact | truth.contact).sum() > FACE_IOU


def test_a_contact_that_fills_the_view_is_said_to():
    source, frame, truth = pressed_box("gelsight_mini", 1.25)
    assert truth.contact.mean() > 0.9
    assert any("fills the view" in note for note in estimate_depth(frame, source, None, DepthParams()).notes)


def test_a_light_face_of_which_only_pieces_of_the_rim_are_seen_is_found_all_over():
    source = load_sensor("digit")
    face = shapes.make_shape("square").mesh
    unit = vary_sensor(source, 6)
    touch = simulate_press(face, rigid.translation(0.0, 0.0, -0.025 - face.vertices_mm[:, 2].min()), unit, seed=1)
    frame = TactileFrame(sensor="digit", image=touch.image, reference=optics.render_reference(unit))
    found = estimate_depth(frame, source, None, DepthParams())
    assert (found.contact & touch.truth.contact).sum() / (found.contact | touch.truth.contact).sum() > FACE_IOU


def test_what_is_looked_at_around_a_touch_ends_in_a_round_line():
    touched = np.zeros((40, 50), np.bool_)
    touched[20, 25] = True
    window = change_detection.grow_to_window(touched, (320, 400), 0.05)
    y, x = np.nonzero(window.changed)
    y, x = y + window.rows.start - 163.5, x + window.cols.start - 203.5
    edge = [np.hypot(x, y)[np.abs(np.arctan2(y, x) - angle) < 0.05].max() for angle in np.linspace(-3, 3, 25)]
    assert np.ptp(edge) < 6.0  # 2 mm are 40 px; squares of 8 px would leave 16
    assert (np.diff(np.sort(np.unique(window.blend_weight))) < 0.1).all()
