"""Invariants of a window after any input: it becomes idle, every pane shows an image, memory
does not grow.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PyQt6.QtCore import QCoreApplication, QSize
from PyQt6.QtGui import QImage
from PyQt6.QtWidgets import QWidget

from app.document.session_controller import SessionController
from app.shell.tour import wait_until_shown
from app.window.jobs import LatestJob
from pipeline.core.errors import TouchError
from pipeline.core.memo import Memo
from widgets.views.canvas import Canvas
from widgets.views.view_3d import View3D

PATIENCE_S = 20.0  # before what goes on is cancelled
# seeds, sweeps and a scan of all frames may go on; on a busy machine they take their time
REST_S = 120.0
SETTLED_S = 20.0
_WALKED = (np.ndarray, QImage, Mapping, tuple, list)
_FILLED = ("computed", "cached", "unchanged", "read", "warning")


def resize_window(window: QWidget, size: tuple[int, int], qtbot) -> None:
    """Give a window a size; on a busy machine a late answer to an earlier request may undo the
    first try.
    """

    def has_size() -> bool:
        window.resize(*size)
        return window.size() == QSize(*size)

    qtbot.waitUntil(has_size, timeout=240_000)
    qtbot.wait(20)
    qtbot.waitUntil(has_size, timeout=240_000)


def find_control(controller: SessionController, name: str) -> QWidget:
    """The control of a parameter of the generated touch's method."""
    touch = next(method for method in controller.methods if method.stage == "touch")
    control = controller.window.parameters.findChild(QWidget, f"{touch.key}.{name}")
    assert control is not None
    return control


class Watched:
    """Checks one window; `complain` receives every problem."""

    def __init__(self, controller: SessionController, complain: Callable[[str], None]) -> None:
        self._instrument = controller
        self._window = controller.window
        self._complain = complain
        # seconds, of the process, of that kept on purpose
        self.memory_mb: list[tuple[float, float, float]] = []
        self.solids_drawn = self.panes_looked_at = self.n_cancelled = 0
        self._begun_s = time.monotonic()
        for job in controller.findChildren(LatestJob):
            job.failed.connect(self._failed)
        logging.getLogger("tactoscope").addHandler(_Errors(complain))

    @property
    def canvases(self) -> list[Canvas]:
        """Every picture of the window."""
        return self._window.findChildren(Canvas)

    def growth_mb(self) -> float:
        """Growth of process memory after the first third of the time, without cached values."""
        held = [process - kept for _, process, kept in self.memory_mb]
        third = max(1, len(held) // 3)
        return (
            float(np.median(held[-third:]) - np.median(held[third : 2 * third]))
            if len(held) > 8
            else 0.0
        )

    def come_to_rest(self) -> None:
        """Everything is still, and what is seen has ink."""
        window = self._window
        window.timeline.play(on=False)
        wait_until_shown(self._instrument, PATIENCE_S)
        self._wait(PATIENCE_S)
        if (
            not self._instrument.is_idle or self._busy()
        ):  # a thousand steps, sixty seeds: whoever is tired of them cancels
            self.n_cancelled += 1
            window.actions_by_name["cancel"].trigger()
            for job in self._busy():
                job.cancel()
            wait_until_shown(self._instrument, REST_S)
            self._wait(REST_S)
        window.banner.hide()
        if not self._instrument.is_idle:
            self._complain("it does not come to rest")
        for job in self._busy():
            self._complain(f"the background of {type(job.parent()).__name__} does not come to rest")
        self._settle()
        self._take_memory()
        if self._instrument.session.recording is not None and self._instrument.is_idle:
            self._look_at_panes()

    def _wait(self, limit_s: float) -> None:
        end_s = time.monotonic() + limit_s
        while self._busy() and time.monotonic() < end_s:
            QCoreApplication.processEvents()
            time.sleep(0.005)

    def _settle(self) -> None:
        """Let what was typed take effect, and what is seen be drawn.

        A column that still waits for work is stuck.
        """
        end_s = time.monotonic() + SETTLED_S
        while time.monotonic() < end_s:
            QCoreApplication.processEvents()
            time.sleep(0.005)
            stuck = self._stuck()
            if self._instrument.is_idle and not stuck and not self._window.alignment.dragging:
                break
        else:
            kept = {"requests": self._instrument.requests}
            columns = {name: column.state for name, column in self._window.columns.items()}
            kept |= {
                "newest": self._instrument.job.newest_ticket,
                "route": self._instrument.session.route,
            }
            kept |= {
                "fresh": sorted(self._instrument.views._fresh),
                "visible": self._window.visible_columns(),
            }
            self._complain(f"{self._stuck()} wait for nothing: {kept}, {columns}")
        self._instrument.views.scene.draw_pending()
        QCoreApplication.processEvents()

    def _stuck(self) -> list[str]:
        """The columns in sight that wait for work."""
        if self._instrument.session.recording is None:
            return []
        columns = self._window.columns
        return [
            name
            for name in self._window.visible_columns()
            if columns[name].state in ("stale", "running", "preview", "draft")
        ]

    def _busy(self) -> list[LatestJob]:
        """Busy jobs other than the one of the stages."""
        own = self._instrument.job
        return [
            job
            for job in self._instrument.findChildren(LatestJob)
            if job is not own and job.is_busy
        ]

    def _look_at_panes(self) -> None:
        """Columns and tiles that are filled show something, and so do 3D views that anybody
        sees.
        """
        window = self._window
        for name in window.visible_columns():
            column = window.columns[name]
            view = window.columns[name].view
            self.panes_looked_at += 1
            if column.state in _FILLED and view.isVisible() and not _in_view(view.canvas):
                continue  # moved out of the pane by hand
            if column.state in _FILLED and not _has_ink(view):
                self._complain(f"{name} is {column.state} and blank")
        for view in window.comparison.current_tab.grid.views:
            shown = (
                view.isVisible() and view.view.preview is not None and _in_view(view.view.canvas)
            )
            if shown and not _has_ink(view):
                self._complain(f"the tile {view.tile.title!r} is blank")
        scene: Any = self._instrument.views.scene
        if not hasattr(scene, "n_renders"):
            return
        self.solids_drawn = scene.n_renders
        for k, solid in enumerate(window.views_3d):
            if (
                solid.isVisible()
                and solid.width() > 20
                and solid.height() > 20
                and not _drawn(solid)
            ):
                self._complain(f"3D view {k} of {solid.width()} x {solid.height()} has no picture")

    def _take_memory(self) -> None:
        """Without garbage and what the allocator only keeps for later; at work it is not taken.

        Looking at every object holds tuples that another thread is just making, and Python refuses
        to finish those.
        """
        if self._instrument.job.is_busy or self._busy():
            return
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        self.memory_mb.append(
            (time.monotonic() - self._begun_s, _resident_mb(), kept_bytes() / 2**20)
        )

    def _failed(self, _ticket: int, error: object) -> None:
        if isinstance(error, BaseException) and not isinstance(error, TouchError):
            calls = traceback.extract_tb(error.__traceback__)[-4:]
            where = ", ".join(f"{Path(call.filename).name}:{call.lineno}" for call in calls)
            self._complain(f"in the background: {type(error).__name__}: {error} ({where})")


class _Errors(logging.Handler):
    def __init__(self, complain: Callable[[str], None]) -> None:
        super().__init__(logging.ERROR)
        self._complain = complain

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info and not isinstance(record.exc_info[1], TouchError):
            self._complain(f"logged: {record.getMessage()}: {record.exc_info[1]!r}")


def kept_bytes() -> int:
    """What all memos hold in this moment, what several of them hold counted once."""
    return kept_bytes_of([memo for memo in gc.get_objects() if issubclass(type(memo), Memo)])


def kept_bytes_of(memos: Sequence[Memo[Any, Any]]) -> int:
    """What these memos hold in this moment, what several of them hold counted once."""
    seen: set[int] = set()
    found = [(answer, weight) for memo in memos for answer, weight in list(memo._values.values())]
    return sum(weight if _opaque(answer) else _held(answer, seen) for answer, weight in found)


def _opaque(answer: object) -> bool:
    """A network: its memo knows what it weighs."""
    return not (isinstance(answer, _WALKED) or is_dataclass(answer))


def _held(value: Any, seen: set[int]) -> int:
    """The bytes of arrays and pictures below a value that are not `seen` yet."""
    if isinstance(value, np.ndarray):
        while isinstance(value.base, np.ndarray):  # a part of another holds all of it
            value = value.base
    if id(value) in seen:
        return 0
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, QImage):
        return value.sizeInBytes()
    if isinstance(value, Mapping):
        return sum([_held(v, seen) for v in value.values()])
    if isinstance(value, (tuple, list)):
        return sum([_held(v, seen) for v in value])
    if is_dataclass(value) and not isinstance(value, type):
        return sum([_held(getattr(value, f.name), seen) for f in fields(value)])
    return 0


def _resident_mb() -> float:
    """What the process holds in memory."""
    line = next(
        s for s in Path("/proc/self/status").read_text().splitlines() if s.startswith("VmRSS")
    )
    return float(line.split()[1]) / 1024.0


def _in_view(canvas: Canvas) -> bool:
    """Whether the middle of what is seen is any of the picture."""
    at = canvas.to_image(canvas.rect().center().toPointF())
    image = canvas._plate.image
    return image is None or (0 <= at.x() < image.width() and 0 <= at.y() < image.height())


def _drawn(solid: View3D) -> bool:
    """A 3D view has a picture, of more than one colour: its axes and the shade of its backdrop
    at least.
    """
    return bool(solid.notice) or (solid.image is not None and _varies(solid.image))


def _has_ink(view: QWidget) -> bool:
    """Whether a picture with its words is anything but one colour."""
    if not view.isVisible() or view.width() < 20 or view.height() < 20:
        return True
    return _varies(view.grab().toImage())


def _varies(image: QImage) -> bool:
    plain = image.convertToFormat(QImage.Format.Format_RGB888)
    bits: Any = plain.constBits()
    bits.setsize(plain.sizeInBytes())
    pixels = np.frombuffer(bits, np.uint8).reshape(plain.height(), plain.bytesPerLine())[
        :, : 3 * plain.width()
    ]
    return bool(pixels.std() > 0.5)
