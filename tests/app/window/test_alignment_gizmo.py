"""The gizmo over *Align*'s pane moves the same six offsets as the handles."""

from __future__ import annotations

import math

import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt

from app.align.alignment import AlignmentController
from app.session.sample import SAMPLE_RECORDING
from app.shell.tour import wait_until_shown
from widgets.views.gizmo import Gizmo

LIMIT_S = 240
LIMIT_MS = 240_000


@pytest.fixture
def grasped(open_window, qtbot):
    controller = open_window(
        SAMPLE_RECORDING.with_name("digit_gelslim.h5"), source="digit", target="gelslim", frame=3
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
    middle = canvas.to_screen(gizmo._at)
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
    moved = canvas.to_screen(gizmo._at)
    assert moved.x() - middle.x() == pytest.approx(25.0, abs=2.0)  # it stays under the pointer
    controller.undo_stack.undo()
    qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
    assert canvas.to_screen(gizmo._at).x() == pytest.approx(middle.x(), abs=1.0)


def test_the_centre_translates_and_the_ring_rotates(grasped, qtbot):
    controller, aligning, gizmo = grasped
    canvas = gizmo.parent()
    middle = canvas.to_screen(gizmo._at)
    _drag(qtbot, gizmo, middle, middle + QPointF(-10, 20))
    qtbot.waitUntil(lambda: controller.is_idle and aligning.is_idle, timeout=LIMIT_MS)
    x, y, _ = controller.session.offsets.translation_mm
    assert y == pytest.approx(-2 * x, rel=0.15)
    middle = canvas.to_screen(gizmo._at)
    far = 66.0
    turn = math.radians(20.0)
    begin = middle + QPointF(0, -far)
    end = middle + QPointF(far * math.sin(turn), -far * math.cos(turn))
    assert gizmo.part_at(begin) == "rz"
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
    assert not gizmo.is_dragging
    assert wait_until_shown(controller, LIMIT_S)
