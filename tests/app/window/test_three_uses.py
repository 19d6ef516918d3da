"""The three uses by hand alone: why the translation failed, a demonstration, an alignment
mended, kept and handed on.
"""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtWidgets import QMessageBox

from app.export.export import ExportController
from app.session.state import load_session
from app.shell.tour import wait_until_shown
from widgets.shell.welcome import WelcomePage

AS_USERS_HAVE_IT = True
LIMIT_S = 240
LIMIT_MS = 240_000
_LEFT = Qt.MouseButton.LeftButton
_KEY = Qt.Key


@pytest.fixture
def hands(open_window, qtbot):
    """An empty window in front, and what presses a key and waits for what it shows."""
    controller = open_window()
    window = controller.window
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow, timeout=LIMIT_MS)

    def press(key, modifier=Qt.KeyboardModifier.NoModifier) -> None:
        qtbot.keyClick(window, key, modifier)
        assert wait_until_shown(controller, LIMIT_S), window.banner.text

    return controller, press


@pytest.mark.slow  # twelve seconds of work: each of its parts has a test of its own in `make test`
def test_a_new_user_inspects_corrects_saves_and_exports(hands, qtbot, tmp_path, monkeypatch):
    controller, press = hands
    window = controller.window
    page = window.findChild(WelcomePage)
    qtbot.mouseClick(page.buttons[0], _LEFT)  # Open the sample
    assert wait_until_shown(controller, LIMIT_S), window.banner.text
    assert page.isHidden()
    assert controller.latest_frame.results["depth"].output.contact.any(), (
        "it opens on a touched frame"
    )

    # Why did it fail? The worst frame, truth under the wipe handle, a pixel's whole way with truth
    # at its end.
    known = window.frames.model
    qtbot.waitUntil(
        lambda: sum(known.get_summary(i) is not None for i in range(known.rowCount())) > 3,
        timeout=LIMIT_MS,
    )
    press(_KEY.Key_J, Qt.KeyboardModifier.ShiftModifier)
    worst = controller.session.frame
    press(_KEY.Key_W)
    view = window.columns["touch"].view
    rows, cols = view.preview.pixels.shape[:2]
    at = view.canvas.to_screen(QPointF(0.5 * cols, 0.3 * rows)).toPoint()
    qtbot.mousePress(view.canvas, _LEFT, pos=at)
    qtbot.mouseMove(view.canvas, at + QPoint(-40, 0))
    qtbot.mouseRelease(view.canvas, _LEFT, pos=at + QPoint(-40, 0))
    assert view.overlay.share < 0.5
    touched = controller.latest_frame.results["touch_depth"].output.contact.nonzero()
    middle = len(touched[0]) // 2
    spot = view.canvas.to_screen(
        QPointF(float(touched[1][middle]), float(touched[0][middle]))
    ).toPoint()
    qtbot.mouseClick(view.canvas, _LEFT, pos=spot)
    controller.probe.draw_pending()
    assert window.trace.text.count("→") == len(window.columns), "every stage, and truth at the end"

    press(_KEY.Key_3, Qt.KeyboardModifier.ControlModifier)

    # The alignment: a number is typed.
    row = window.alignment.rows["x"]
    qtbot.waitUntil(row.box.isEnabled, timeout=LIMIT_MS)
    row.box.setFocus()
    row.box.selectAll()
    qtbot.keyClicks(row.box, "0.5")
    qtbot.keyClick(row.box, _KEY.Key_Return)
    qtbot.waitUntil(
        lambda: controller.session.offsets.translation_mm[0] == pytest.approx(0.5), timeout=LIMIT_MS
    )
    assert wait_until_shown(controller, LIMIT_S), window.banner.text
    assert controller.session.frame == worst

    # Kept, handed on, and left with unsaved work.
    monkeypatch.setattr(
        "PyQt6.QtWidgets.QFileDialog.getSaveFileName", lambda *_args: (str(tmp_path / "mine"), "")
    )
    press(_KEY.Key_S, Qt.KeyboardModifier.ControlModifier)
    assert load_session(tmp_path / "mine.touch.json").offsets.translation_mm[0] == pytest.approx(
        0.5
    )
    press(_KEY.Key_1, Qt.KeyboardModifier.ControlModifier)
    press(_KEY.Key_E, Qt.KeyboardModifier.ControlModifier)
    monkeypatch.setattr(
        "PyQt6.QtWidgets.QFileDialog.getSaveFileName",
        lambda *_args: (str(tmp_path / "out.png"), ""),
    )
    handing = next(child for child in controller.children() if isinstance(child, ExportController))
    qtbot.mouseClick(handing.dialog.write, _LEFT)
    qtbot.waitUntil(
        lambda: (tmp_path / "out.png").exists() and not handing.job.is_busy, timeout=LIMIT_MS
    )
    handing.dialog.close()
    for _ in range(2):  # the layout, and the number that was typed
        press(_KEY.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert controller.session.offsets.translation_mm[0] == 0.0
    asked = []
    monkeypatch.setattr(
        QMessageBox, "question", lambda *_args: asked.append(1) or QMessageBox.StandardButton.Cancel
    )
    qtbot.keyClick(window, _KEY.Key_Q, Qt.KeyboardModifier.ControlModifier)
    assert asked == [1]
    assert window.isVisible()
