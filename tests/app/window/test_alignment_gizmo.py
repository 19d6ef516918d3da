"""The gizmos over image and scene of *Align* move the same six offsets as the handles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PyQt6.QtCore import QCoreApplication, QEvent, QPoint, QPointF, Qt
from PyQt6.QtGui import QMouseEvent

from app.align.alignment import AlignmentController
from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from pipeline.core.geometry import rigid
from pipeline.sensors.alignment import Offsets, decompose_motion
from pipeline.views.gizmo import BALL, CENTRE
from widgets.views.gizmo import Gizmo

LIMIT_S = 240
LIMIT_MS = 240_000


@pytest.fixture
def grasped(open_window, qtbot):
    return _open_align(open_window, qtbot)


def _open_align(open_window, qtbot, *, gl: bool = False):
    controller = open_window(
        SAMPLE_RECORDING.with_name("digit_gelslim.h5"),
        gl=gl,
        source="digit",
        target="gelslim",
        frame=3,
    )
    assert wait_until_shown(controller, LIMIT_S), controller.window.banner.text
    controller.window.actions_by_name["layout_align"].trigger()
    aligning = controller.findChild(AlignmentController)
    gizmo = controller.window.columns["target_depth"].view.canvas.findChild(Gizmo)
    qtbot.waitUntil(
        lambda: controller.is_idle and aligning.is_idle and gizmo.isVisible(), timeout=LIMIT_MS
    )
    return controller, aligning, gizmo


def _drag(qtbot, gizmo, begin: QPointF, end: QPointF):
    canvas = gizmo.parent()
    qtbot.mousePress(canvas, Qt.MouseButton.LeftButton, pos=begin.toPoint())
    qtbot.mouseMove(canvas, ((begin + end) / 2).toPoint())
    qtbot.mouseMove(canvas, end.toPoint())
    qtbot.mouseRelease(canvas, Qt.MouseButton.LeftButton, pos=end.toPoint())


def test_an_arrow_moves_along_its_axis_in_one_undo_step(grasped, qtbot):
    controller, aligning, gizmo = grasped
    canvas = gizmo.parent()
    picture = controller.window.columns["target_depth"].view.preview
    middle = QPointF(*gizmo.geometry_px.centre_px)
    steps = controller.undo_stack.count()
    centre = canvas.centre
    grip = middle + QPointF(30, 0)
    _drag(qtbot, gizmo, grip, grip + QPointF(25, 14))
    qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
    x, y, z = controller.session.offsets.translation_mm
    assert x == pytest.approx(25.0 / canvas.scale * picture.pixel_mm, rel=0.1)
    assert (y, z) == (0.0, 0.0)
    assert controller.undo_stack.count() == steps + 1
    assert canvas.centre == centre  # the picture itself was not dragged
    moved = QPointF(*gizmo.geometry_px.centre_px)
    assert moved.x() - middle.x() == pytest.approx(25.0, abs=2.0)  # it stays under the pointer
    controller.undo_stack.undo()
    qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
    assert QPointF(*gizmo.geometry_px.centre_px).x() == pytest.approx(middle.x(), abs=1.0)


def test_the_centre_translates_and_the_ring_rotates(grasped, qtbot):
    controller, aligning, gizmo = grasped
    middle = QPointF(*gizmo.geometry_px.centre_px)
    _drag(qtbot, gizmo, middle, middle + QPointF(-10, 20))
    qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
    x, y, _ = controller.session.offsets.translation_mm
    assert y == pytest.approx(-2 * x, rel=0.15)
    middle = QPointF(*gizmo.geometry_px.centre_px)
    far = 66.0
    turn = math.radians(20.0)
    begin = middle + QPointF(0, -far)
    end = middle + QPointF(far * math.sin(turn), -far * math.cos(turn))
    assert gizmo.geometry_px.find_part(np.array([begin.x(), begin.y()])) == "rz"
    _drag(qtbot, gizmo, begin, end)
    qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
    assert controller.session.offsets.rotation_deg[2] == pytest.approx(
        20.0, abs=1.5
    )  # clockwise on screen: from x to y
    assert controller.session.offsets.translation_mm[:2] == pytest.approx((x, y), abs=1e-6)


def test_the_gizmo_is_visible_in_align_only(grasped, qtbot):
    controller, _, gizmo = grasped
    controller.window.actions_by_name["layout_look"].trigger()
    assert wait_until_shown(controller, LIMIT_S)
    assert gizmo.isHidden()
    canvas = gizmo.parent()
    qtbot.mousePress(canvas, Qt.MouseButton.LeftButton, pos=QPoint(40, 40))
    qtbot.mouseRelease(canvas, Qt.MouseButton.LeftButton, pos=QPoint(40, 40))
    assert not gizmo._held
    assert wait_until_shown(controller, LIMIT_S)


class _Hand:
    """Drags a part of the scene's gizmo: in whole pixels, at last with Shift."""

    def __init__(self, gizmo: Gizmo, part: str) -> None:
        self._view = gizmo.parent()
        shape = gizmo.geometry_px
        middle = QPointF(*shape.centre_px)
        grid = [QPoint(x, y) for x in range(-75, 76, 2) for y in range(-75, 76, 2)]
        places = [middle.toPoint() + off for off in grid]
        self._at = next(p for p in places if shape.find_part(np.array([p.x(), p.y()])) == part)
        self._send(QEvent.Type.MouseButtonPress)

    def _send(self, kind: QEvent.Type, *, shift: bool = False) -> None:
        buttons = Qt.MouseButton.LeftButton
        keys = Qt.KeyboardModifier
        held = Qt.MouseButton.NoButton if kind == QEvent.Type.MouseButtonRelease else buttons
        modifiers = keys.ShiftModifier if shift else keys.NoModifier
        at = QPointF(self._at)
        button = Qt.MouseButton.NoButton if kind == QEvent.Type.MouseMove else buttons
        event = QMouseEvent(kind, at, self._view.mapToGlobal(at), button, held, modifiers)
        QCoreApplication.sendEvent(self._view, event)

    def move(self, x_px: float, y_px: float) -> None:
        """Go as far as whole pixels do, and what is left with Shift, ten times as far."""
        for times, shift in ((1.0, False), (10.0, True)):
            step = QPoint(round(times * x_px), round(times * y_px))
            self._at += step
            self._send(QEvent.Type.MouseMove, shift=shift)
            x_px, y_px = x_px - step.x() / times, y_px - step.y() / times

    def end(self) -> None:
        self._send(QEvent.Type.MouseButtonRelease)


def _turn_left(offsets: Offsets) -> np.ndarray:
    """The rotation vector, rad, that is left to be done."""
    return -np.deg2rad(offsets.rotation_deg)


@pytest.mark.gl
def test_four_drags_in_the_scene_undo_a_motion_of_all_six_axes(open_window, qtbot):
    """From 2 mm and 5 degrees to .15 mm and .1 degree, without a number typed."""
    controller, aligning, _ = _open_align(open_window, qtbot, gl=True)
    view = controller.window.scene_panel.view
    assert view.isVisible()
    qtbot.waitUntil(lambda: controller.views.scene.is_open, timeout=LIMIT_MS)
    pivot = tuple(float(v) for v in aligning.contact_centre_mm)
    off_mm, off_deg = np.array((1.2, -1.0, 1.25)), np.array((3.0, -2.5, 3.1))
    controller.change(
        "move",
        offsets=Offsets(translation_mm=tuple(off_mm), rotation_deg=tuple(off_deg), pivot_mm=pivot),
    )

    def rest():
        qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
        controller.views.scene.draw_pending()

    rest()
    assert np.linalg.norm(off_mm) == pytest.approx(2.0, abs=0.01)
    assert np.linalg.norm(off_deg) == pytest.approx(5.0, abs=0.02)
    gizmo = view.findChild(Gizmo)
    assert gizmo.isVisible()
    steps = controller.undo_stack.count()

    # the ball turns about two axes across the line of sight, a ring about the third
    px_of_mm = gizmo.geometry_px.px_of_mm
    right, down = (row / np.linalg.norm(row) for row in px_of_mm)
    toward = np.cross(down, right)
    ring = int(np.argmax(np.abs(toward)))
    by_ring = (_turn_left(aligning.offsets) @ toward) / toward[ring]
    hand = _Hand(gizmo, BALL)
    for _ in range(4):  # until what is left is about the ring's axis alone
        left = _turn_left(aligning.offsets)
        by_ring = (left @ toward) / toward[ring]
        left = left - by_ring * np.eye(3)[ring]
        hand.move(66.0 * left @ np.cross(toward, right), 66.0 * left @ np.cross(toward, down))
    hand.end()
    rest()
    hand = _Hand(gizmo, ("rx", "ry", "rz")[ring])
    others = [(ring + 1) % 3, (ring + 2) % 3]
    for _ in range(4):
        middle = gizmo.geometry_px.centre_px
        at = np.array([hand._at.x(), hand._at.y()])
        in_plane = np.linalg.solve(gizmo.geometry_px.px_of_mm[:, others], at - middle)
        angle = _turn_left(aligning.offsets)[ring]
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        hand.move(*(gizmo.geometry_px.px_of_mm[:, others] @ (turned @ in_plane - in_plane)))
    hand.end()
    rest()
    # the centre moves in the plane of the view, an arrow to the eye
    arrow = int(np.argmax(np.abs(toward)))
    hand = _Hand(gizmo, CENTRE)
    for _ in range(4):
        left = np.array(pivot) - aligning.contact_centre_mm
        left = left - (left @ toward) / toward[arrow] * np.eye(3)[arrow]
        hand.move(*(gizmo.geometry_px.px_of_mm @ left))
    hand.end()
    rest()
    hand = _Hand(gizmo, "xyz"[arrow])
    for _ in range(4):
        left = np.array(pivot) - aligning.contact_centre_mm
        hand.move(*(gizmo.geometry_px.px_of_mm[:, arrow] * left[arrow]))
    hand.end()
    rest()
    assert controller.undo_stack.count() == steps + 4
    found = decompose_motion(controller.session.offsets.to_matrix(), pivot)
    error_mm = np.linalg.norm(found.translation_mm)
    error_deg = np.rad2deg(np.linalg.norm(rigid.rotation_vector_rad(found.to_matrix())))
    assert error_mm < 0.15
    assert error_deg < 0.1
    controller.undo_stack.undo()
    rest()
    assert not controller.session.offsets.is_zero
