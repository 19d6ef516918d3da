"""A seeded monkey: it triggers commands, moves controls, turns views, opens files good and bad,
and says what it broke.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from PyQt6.QtCore import QCoreApplication, QPoint, QPointF, Qt, QTimer
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QApplication,
    QCheckBox,
    QComboBox,
    QDialog,
    QScrollBar,
    QTabWidget,
    QToolButton,
    QWidget,
)

from app.document.session_controller import SessionController
from app.session.sample import SAMPLE_RECORDING
from tests.app.window.window_checks import Watched

# those that ask for a file by a box of the system's, close the window or show a box
_LEFT_ALONE = frozenset(
    (
        "open_recording",
        "set_variant_recording",
        "open_folder",
        "open_mesh",
        "open_calibration",
        "open_weights",
        "open_reference",
        "open_alignment",
        "save_alignment",
        "open_session",
        "save_session",
        "save_session_as",
        "save_screenshot",
        "export_bundle",
        "save_video",
        "open_rollouts",
        "open_track",
        "export_track",
        "export_rollout_video",
        "quit",
    )
)
# parts of names of buttons that ask for a file, or open a menu that waits
_NO_BUTTONS = (
    "record",
    "browse",
    "write",
    "folder",
    "offer_choose",
    "offer_calibrate",
    "offer_which",
)
# acts; then everything must come to rest, every pane must have ink, and memory is taken
_REST_EVERY = 25
_SIZES = ((1366, 768), (1600, 950), (1100, 700), (1900, 1100))


class Monkey:
    """Plays with one window; `complaints` says what went wrong, with the acts that led there."""

    def __init__(
        self,
        controller: SessionController,
        rng: random.Random,
        *,
        folder: Path,
        good: tuple[Path, ...],
    ) -> None:
        self._instrument = controller
        self._rng = rng
        self._window = controller.window
        self._files = [*good, *sorted(SAMPLE_RECORDING.parent.glob("*.h5")), *_bad_files(folder)]
        self.complaints: list[str] = []
        self.n_acts = 0
        self._lately: list[str] = []
        self.watched = Watched(controller, self._complain)
        self._acts: tuple[tuple[int, Callable[[], str]], ...] = (
            (5, self._command),
            (5, self._control),
            (3, self._frame),
            (2, self._hover),
            (1, self._file),
            (2, self._key),
            (2, self._button),
            (2, self._mouse),
            (1, self._tab),
            (1, self._resize),
        )

    def play(self, seconds: float) -> None:
        """Act until the time is over; what is not caught anywhere is a complaint."""
        hook = sys.excepthook
        sys.excepthook = self._uncaught
        closing = QTimer()  # a box that waits for an answer has an event loop of its own
        closing.timeout.connect(_dismiss)
        closing.start(200)
        weights, acts = zip(*self._acts, strict=True)
        end_s = time.monotonic() + seconds
        try:
            while time.monotonic() < end_s and not self.complaints:
                self._lately.append("?")
                self._lately[-1] = self._rng.choices(acts, weights)[0]()
                self.n_acts += 1
                QCoreApplication.processEvents()
                self._close_boxes()
                if self.n_acts % _REST_EVERY == 0:
                    self.watched.come_to_rest()
            self.watched.come_to_rest()
        finally:
            closing.stop()
            sys.excepthook = hook

    def _command(self) -> str:
        actions = [
            a
            for name, a in self._window.actions_by_name.items()
            if a.isEnabled() and name not in _LEFT_ALONE
        ]
        action = self._rng.choice(actions)
        action.trigger()
        return f"command {action.objectName()}"

    def _control(self) -> str:
        kinds = (QComboBox, QAbstractSpinBox, QAbstractSlider, QCheckBox)
        found = [
            c
            for kind in kinds
            for c in self._window.findChildren(kind)
            if c.isVisible() and c.isEnabled() and not isinstance(c, QScrollBar)
        ]
        if not found:
            return "no control"
        control: Any = self._rng.choice(found)
        if isinstance(control, QComboBox):
            index = self._rng.randrange(max(1, control.count()))
            control.setCurrentIndex(index)
            control.activated.emit(index)
        elif isinstance(control, QCheckBox):
            control.toggle()
        elif isinstance(control, QAbstractSpinBox):
            control.stepBy(self._rng.choice((-10, -1, 1, 10)))
        else:
            control.setValue(self._rng.randint(control.minimum(), control.maximum()))
        return f"{type(control).__name__} {control.objectName()}"

    def _button(self) -> str:
        """Those that are no command of the window's: commands have a turn of their own."""
        found = [
            b
            for b in self._window.findChildren(QAbstractButton)
            if b.isVisible()
            and b.isEnabled()
            and not any(part in b.objectName() for part in _NO_BUTTONS)
            and not (
                isinstance(b, QToolButton)
                and (b.defaultAction() is not None or b.menu() is not None)
            )
        ]
        if not found:
            return "no button"
        button = self._rng.choice(found)
        description = f"button {button.objectName() or button.text()}"
        button.click()
        return description

    def _mouse(self) -> str:
        """Drag, or turn the wheel, over a picture or a 3D view."""
        seen = [
            v
            for v in (*self.watched.canvases, *self._window.views_3d)
            if v.isVisible() and v.width() > 20
        ]
        if not seen:
            return "no view"
        view: QWidget = self._rng.choice(seen)
        ends = [
            QPoint(self._rng.randrange(view.width()), self._rng.randrange(view.height()))
            for _ in range(2)
        ]
        what = self._rng.choice(("drag", "wheel", "click", "double"))
        if what == "wheel":
            QApplication.sendEvent(
                view, _wheel(view, ends[0], self._rng.choice((-240, -120, 120, 240)))
            )
        elif what == "double":
            QTest.mouseDClick(view, Qt.MouseButton.LeftButton, pos=ends[0])
        else:
            button = self._rng.choice((Qt.MouseButton.LeftButton, Qt.MouseButton.MiddleButton))
            QTest.mousePress(view, button, pos=ends[0])
            if what == "drag":
                QTest.mouseMove(view, ends[1])
            QTest.mouseRelease(view, button, pos=ends[1] if what == "drag" else ends[0])
        return f"{what} on {type(view).__name__} {view.width()}x{view.height()}"

    def _tab(self) -> str:
        tabs = [t for t in self._window.findChildren(QTabWidget) if t.isVisible() and t.count() > 1]
        if not tabs:
            return "no tabs"
        tab = self._rng.choice(tabs)
        tab.setCurrentIndex(self._rng.randrange(tab.count()))
        return f"tab {tab.objectName()} {tab.currentIndex()}"

    def _resize(self) -> str:
        size = self._rng.choice(_SIZES)
        self._window.resize(*size)
        return f"resize {size}"

    def _frame(self) -> str:
        line = self._window.timeline
        line.step_to(self._rng.randint(0, line.slider.maximum()))
        return f"frame {line.frame}"

    def _hover(self) -> str:
        name = self._rng.choice(list(self._window.columns))
        view = self._window.columns[name].view
        row = self._rng.randint(-1, 400)
        col = self._rng.randint(-1, 500)
        (view.pixel_hovered if self._rng.random() < 0.8 else view.pixel_clicked).emit(row, col)
        return f"hover {name} {row} {col}"

    def _file(self) -> str:
        path = self._rng.choice(self._files)
        self._instrument.open_paths([path])
        return f"open {path.name}"

    def _key(self) -> str:
        key = self._rng.choice(
            (Qt.Key.Key_Left, Qt.Key.Key_Right, Qt.Key.Key_Escape, Qt.Key.Key_J, Qt.Key.Key_R)
        )
        QTest.keyClick(self._window, key)
        return f"key {key.name}"

    def _close_boxes(self) -> None:
        popup = QApplication.activePopupWidget()
        if popup is not None:
            popup.close()
        for dialog in self._window.findChildren(QDialog):
            if dialog.isVisible():
                dialog.reject()

    def _uncaught(
        self, kind: type[BaseException], error: BaseException, _trace: TracebackType | None
    ) -> None:
        self._complain(f"{kind.__name__}: {error}")

    def _complain(self, what: str) -> None:
        self.complaints.append(f"{what}; lately: {', '.join(self._lately[-12:])}")


def _dismiss() -> None:
    """Give the box that waits for an answer none."""
    box = QApplication.activeModalWidget()
    if box is not None:
        box.close()


def _wheel(view: QWidget, at: QPoint, by: int) -> QWheelEvent:
    place = QPointF(at)
    return QWheelEvent(
        place,
        view.mapToGlobal(place),
        QPoint(0, 0),
        QPoint(0, by),
        Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )


def _bad_files(folder: Path) -> list[Path]:
    """Empty, cut short, of another kind, poisoned, and not there."""
    whole = SAMPLE_RECORDING.read_bytes()
    contents = {
        "empty.h5": b"",
        "cut.h5": whole[: len(whole) // 3],
        "text.png": b"no picture",
        "no.stl": b"solid nothing",
        "poison.obj": b"v nan 0 0\nv 1e308 0 0\nv 0 inf 0\nf 1 2 3\n",
        "bad.touch.json": b'{"tactoscope session": 99}',
        "bad.toml": b"[alignment_from_source]\n",
        "bad.npz": b"PK\x03\x04 and no more",
        "bad.safetensors": b"\xff" * 64,
    }
    paths = [folder / name for name in contents]
    for path in paths:
        path.write_bytes(contents[path.name])
    np.save(folder / "depth_nan.npy", np.full((3, 140, 175), np.nan, np.float32))
    return [*paths, folder / "depth_nan.npy", folder / "missing.h5", folder]
