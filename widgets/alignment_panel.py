"""The Alignment dock: six numbers to drag, gauges that answer, bars that say which axis matters, and refining."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import (
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from pipeline.alignment.score import Score
from pipeline.alignment.sensitivity import Sensitivity
from pipeline.sensors.offsets import AXES, Axis
from widgets.axis_bars import AxisBars
from widgets.axis_row import AxisRow
from widgets.gauge import Gauge, GaugeScale
from widgets.looks import InkLabel, bold, command_button, icon_button, once, smaller, spaced
from widgets.refine_box import RefineBox

STILL_MS = 350  # without a turn of the wheel or a key, a change made by them is over

_IOU = GaugeScale(
    name="mask IoU", unit="", full=1.0, digits=3, higher_is_better=True,
    help="contact carried over and contact felt: intersection over union",
)  # fmt: skip
_EDGE = GaugeScale(
    name="edge", unit="px", full=20.0, digits=2, higher_is_better=False,
    help="mean distance of the two outlines, in pixels of the target's full image",
)  # fmt: skip


def depth_scale(full_mm: float) -> GaugeScale:
    """The gauge of depth for a sensor: a bubble gives way ten times as far as a gel."""
    return GaugeScale(
        name="depth", unit="mm", full=full_mm, digits=3, higher_is_better=False,
        help="median absolute difference of depth where both are in contact",
    )  # fmt: skip


class AlignmentPanel(QScrollArea):
    """Values in, signals out: `moved` follows every motion of a handle, between `drag_begun` and `drag_ended`."""

    drag_begun = pyqtSignal()
    moved = pyqtSignal(str, float)  # axis, offset in mm or degrees
    drag_ended = pyqtSignal()
    reset_wanted = pyqtSignal()
    pivot_wanted = pyqtSignal()
    original_wanted = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("alignment")
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.rows = {axis: AxisRow(axis, self) for axis in AXES}
        self.gauges = {"iou": Gauge(_IOU), "edge_px": Gauge(_EDGE), "depth_mm": Gauge(depth_scale(1.0))}
        self.bars, self.refine = AxisBars(), RefineBox()
        self.dragging = False  # whether a handle is being moved
        self._still = once(self, STILL_MS, self._end)
        self._origin, self._pivot, self._reason = QLabel(), QLabel(), InkLabel(lambda inks: inks.alarm)
        self._lay_out()
        for row in self.rows.values():
            row.grabbed.connect(self._begin)
            row.released.connect(self._end)
            row.moved.connect(self._move)

    def _lay_out(self) -> None:
        body = QWidget()
        layout = spaced(QVBoxLayout(body), 5, (8, 6, 8, 6))
        layout.addLayout(self._head())
        self._handles = QWidget()
        grid = spaced(QGridLayout(self._handles), 4)
        grid.setColumnStretch(1, 1)
        for n, row in enumerate(self.rows.values()):
            for column, widget in enumerate((row.label, row.slider, row.box)):
                grid.addWidget(widget, n, column)
        layout.addWidget(self._handles)
        layout.addLayout(self._foot())
        layout.addWidget(_title("Agreement with what was felt"))
        self._reason.setWordWrap(True)
        layout.addWidget(self._reason)
        for gauge in self.gauges.values():
            layout.addWidget(gauge)
        layout.addWidget(_title("Which axis matters"))
        layout.addWidget(self.bars)
        layout.addWidget(_title("Refine"))
        layout.addWidget(self.refine)
        layout.addStretch(1)
        self.setWidget(body)
        self.setMinimumWidth(body.minimumSizeHint().width())
        self.show_nothing()

    def _head(self) -> QHBoxLayout:
        self._origin.setWordWrap(True)
        self._original = icon_button(
            "reset", "alignment_original", "Back to the alignment that comes with the recording"
        )
        self._original.clicked.connect(self.original_wanted)
        self._files = spaced(QHBoxLayout(), 1)
        head = QHBoxLayout()
        head.addWidget(self._origin, 1)
        head.addWidget(self._original)
        head.addLayout(self._files)
        return head

    def _foot(self) -> QHBoxLayout:
        self._pivot.setWordWrap(True)
        smaller(self._pivot, 1.0, least_pt=7.5)
        self._here = icon_button(
            "target", "alignment_pivot", "Tell the same motion about the middle of this frame's contact"
        )
        self._here.clicked.connect(self.pivot_wanted)
        self._reset = icon_button("reset", "alignment_reset", "Take all six offsets back to zero")
        self._reset.clicked.connect(self.reset_wanted)
        foot = QHBoxLayout()
        foot.addWidget(self._pivot, 1)
        foot.addWidget(self._here)
        foot.addWidget(self._reset)
        return foot

    def add_command(self, action: QAction) -> None:
        """Give a command a button at the top."""
        self._files.addWidget(command_button(action))

    @property
    def reason(self) -> str:
        """Why there is no score, "" if there is one."""
        return self._reason.text()

    @property
    def origin(self) -> str:
        """Whose alignment is open and whether it was moved."""
        return self._origin.text()

    def show_nothing(self) -> None:
        """No frame is judged yet: there is nothing to move."""
        self._handles.setEnabled(False)
        self.show_score(None, "")
        self.mark_ghosts(None)
        self.bars.show_axes(())

    def show_ready(self, frame: str, depth_mm: float, pixel_mm: float) -> None:
        """Handles work now, along the axes of `frame`; `depth_mm` is where the gauge of depth is full."""
        self._handles.setEnabled(True)
        self.bars.show_pixel(pixel_mm)
        self.gauges["depth_mm"].show_scale(depth_scale(depth_mm))
        for row in self.rows.values():
            row.tell_frame(frame)

    def show_origin(self, origin: str, *, edited: bool, from_file: bool) -> None:
        """Name the opened alignment, and whether it was moved."""
        self._origin.setText(f"<b>{origin}</b>" + (", moved by" if edited else ""))
        self._original.setVisible(from_file)
        self._reset.setEnabled(edited)

    def show_values(self, values: Sequence[float]) -> None:
        """Show the six offsets without saying so to anybody."""
        for row, value in zip(self.rows.values(), values, strict=True):
            row.show_value(value)

    def show_pivot(self, pivot_mm: Sequence[float], frame: str, *, elsewhere: bool) -> None:
        """Where turns are about; `elsewhere` than this frame's contact offers to move it."""
        at = ", ".join(f"{v:.1f}" for v in pivot_mm)
        whose = "another frame's contact" if elsewhere else "the contact's middle"
        self._pivot.setText(f"offsets in the {frame} frame; turns about {whose}, ({at}) mm")
        self._here.setVisible(elsewhere)

    def show_score(self, score: Score | None, reason: str) -> None:
        """Show how well it agrees, or why that cannot be told."""
        self._reason.setText(reason)
        self._reason.setVisible(bool(reason))
        for name, gauge in self.gauges.items():
            gauge.show_value(None if score is None else getattr(score, name))

    def mark_ghosts(self, score: Score | None) -> None:
        """Put the ticks at the figures of this score."""
        for name, gauge in self.gauges.items():
            gauge.mark_ghost(None if score is None else getattr(score, name))

    def show_axes(self, axes: Sequence[Sensitivity]) -> None:
        """Show which axis matters."""
        self.bars.setEnabled(True)
        self.bars.show_axes(axes)

    def take_hold(self) -> None:
        """Somebody takes hold of the touch elsewhere than here."""
        self._begin()

    def drag(self, axis: Axis, value: float) -> None:
        """It is being moved there: the handles follow."""
        self._begin()
        self.rows[axis].show_value(value)
        self.moved.emit(axis, value)

    def let_go(self) -> None:
        """That is over."""
        self._end()

    def _begin(self) -> None:
        if not self.dragging:
            self.dragging = True
            self.bars.setEnabled(False)  # they tell of the place that is being left
            self.drag_begun.emit()

    def _move(self, axis: str, value: float) -> None:
        self._begin()
        if not self.rows[axis].slider.isSliderDown():  # type: ignore[index]
            self._still.start()
        self.moved.emit(axis, value)

    def _end(self) -> None:
        self._still.stop()
        if self.dragging:
            self.dragging = False
            self.drag_ended.emit()


def _title(text: str) -> QLabel:
    label = QLabel(text)
    bold(label)
    label.setContentsMargins(0, 6, 0, 0)
    return label
