"""Alignment dock: six offsets to drag, gauges of the agreement, sensitivity bars, and
refinement.
"""

from collections.abc import Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QGridLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.sensors.alignment import AXES
from pipeline.translation.alignment.score import AlignmentScore, Sensitivity
from widgets.align.refine_box import RefineBox
from widgets.compare.sensitivity_bars import SensitivityBars
from widgets.style.axis_row import AxisRow
from widgets.style.base import VerticalScrollArea
from widgets.style.gauge import Gauge, GaugeScale
from widgets.style.styling import (
    ThemedLabel,
    make_bold,
    make_column,
    make_command_button,
    make_icon_button,
    make_row,
    make_single_shot_timer,
    make_text,
    name_widget,
    set_spacing,
)

SETTLE_MS = 350  # a change by wheel or keys ends after this pause

_IOU = GaugeScale(
    name="mask IoU",
    unit="",
    full_value=1.0,
    digits=3,
    higher_is_better=True,
    help="transferred and observed contact: intersection over union",
)
_EDGE = GaugeScale(
    name="edge",
    unit="px",
    full_value=20.0,
    digits=2,
    higher_is_better=False,
    help="mean distance of the two outlines, in pixels of the target's full image",
)


def make_depth_gauge_scale(full_mm: float) -> GaugeScale:
    """Return the range of the depth gauge of a sensor.

    A bubble deforms ten times as far as a gel.
    """
    return GaugeScale(
        name="depth",
        unit="mm",
        full_value=full_mm,
        digits=3,
        higher_is_better=False,
        help="median absolute difference of depth where both are in contact",
    )


class AlignmentPanel(VerticalScrollArea):
    """Emits `moved` for every motion of a handle, between `drag_begun` and `drag_ended`."""

    drag_started = pyqtSignal()
    offset_changed = pyqtSignal(str, float)  # axis, offset in mm or degrees
    drag_ended = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        name_widget(self, "alignment", "alignment")
        self.rows = {axis: AxisRow(axis, self) for axis in AXES}
        self.gauges = {
            "iou": Gauge(_IOU),
            "edge_px": Gauge(_EDGE),
            "depth_mm": Gauge(make_depth_gauge_scale(1.0)),
        }
        self.bars = SensitivityBars()
        self.refine = RefineBox()
        self.dragging = False  # whether a handle is being dragged
        self._still = make_single_shot_timer(self, SETTLE_MS, self.end_drag)
        self.origin = make_text()
        self._pivot = make_text()
        self.no_score_reason = ThemedLabel(lambda inks: inks.warning_text)
        self._lay_out()
        for row in self.rows.values():
            row.slider.sliderPressed.connect(self.begin_drag)
            row.slider.sliderReleased.connect(self.end_drag)
            row.value_changed.connect(self._move)

    def _lay_out(self) -> None:
        body = QWidget()
        self._handles = QWidget()
        grid = set_spacing(QGridLayout(self._handles), 4)
        grid.setColumnStretch(1, 1)
        for n, row in enumerate(self.rows.values()):
            for column, widget in enumerate((row.label, row.slider, row.box)):
                grid.addWidget(widget, n, column)
        self.no_score_reason.setWordWrap(True)
        make_column(
            5,
            self._head(),
            self._handles,
            self._foot(),
            _title("Agreement"),
            self.no_score_reason,
            *self.gauges.values(),
            _title("Sensitivity"),
            self.bars,
            _title("Refine"),
            self.refine,
            1,
            around_px=(8, 6, 8, 6),
            on=body,
        )
        self.setWidget(body)
        self.show_empty()

    def _head(self) -> QVBoxLayout:
        self.original = make_icon_button(
            "reset", "alignment_original", "Return to the alignment of the recording"
        )
        self._files = make_row(1)
        return make_column(2, make_row(6, (self.origin, 1), self.original), self._files)

    def _foot(self) -> QHBoxLayout:
        self.here = make_icon_button(
            "target",
            "alignment_pivot",
            "Express the same motion about the centre of this frame's contact",
        )
        self.reset = make_icon_button("reset", "alignment_reset", "Reset all six offsets to zero")
        return make_row(6, (self._pivot, 1), self.here, self.reset)

    def add_command(self, action: QAction) -> None:
        """Add a button for a command at the top."""
        button = make_command_button(action)
        button.setAutoRaise(False)  # a word without an icon looks like a title
        self._files.addWidget(button, 1)
        self.updateGeometry()

    def show_empty(self) -> None:
        """Disable the handles while no frame is scored."""
        self._handles.setEnabled(False)
        self.show_score(None, "")
        self.mark_ghosts(None)
        self.bars.show_sensitivities(())

    def show_ready(self, frame: str, depth_mm: float, pixel_mm: float) -> None:
        """Enable the handles along the axes of `frame`.

        `depth_mm` is the full value of the depth gauge.
        """
        self._handles.setEnabled(True)
        self.bars.set_pixel_size(pixel_mm)
        self.gauges["depth_mm"].show_scale(make_depth_gauge_scale(depth_mm))
        for row in self.rows.values():
            row.show_frame_name(frame)

    def show_origin(self, origin: str, *, edited: bool, from_file: bool) -> None:
        """Show the name of the open alignment, and whether it was edited."""
        self.origin.setText(f"{origin}{', moved by' if edited else ''}")
        self.original.setVisible(from_file)
        self.reset.setEnabled(edited)

    def show_values(self, values: Sequence[float]) -> None:
        """Show the six offsets without emitting a signal."""
        for row, value in zip(self.rows.values(), values, strict=True):
            row.show_value(value)

    def show_pivot(self, pivot_mm: Sequence[float], frame: str, *, elsewhere: bool) -> None:
        """Show the pivot of rotations (mm).

        `elsewhere` offers to move it to this frame's contact.
        """
        at = ", ".join(f"{v:.1f}" for v in pivot_mm)
        whose = "another frame's contact" if elsewhere else "the contact's centre"
        self._pivot.setText(f"offsets in the {frame} frame; rotations about {whose}, ({at}) mm")
        self.here.setVisible(elsewhere)

    def show_score(self, score: AlignmentScore | None, reason: str) -> None:
        """Show the agreement, or the reason why there is none."""
        self.no_score_reason.setText(reason)
        self.no_score_reason.setVisible(bool(reason))
        for name, gauge in self.gauges.items():
            gauge.show_value(None if score is None else getattr(score, name))

    def mark_ghosts(self, score: AlignmentScore | None) -> None:
        """Set the ghost ticks of the gauges to this score."""
        for name, gauge in self.gauges.items():
            gauge.mark_ghost(None if score is None else getattr(score, name))

    def show_sensitivities(self, axes: Sequence[Sensitivity]) -> None:
        """Show how sensitive the score is to each axis."""
        self.bars.setEnabled(True)
        self.bars.show_sensitivities(axes)

    def begin_drag(self) -> None:
        """Begin a drag, here or in another widget."""
        if not self.dragging:
            self.dragging = True
            self.bars.setEnabled(False)  # the bars belong to the alignment before the move
            self.drag_started.emit()

    def _move(self, axis: str, value: float) -> None:
        self.begin_drag()
        if not self.rows[axis].slider.isSliderDown():  # type: ignore[index]
            self._still.start()
        self.offset_changed.emit(axis, value)

    def end_drag(self) -> None:
        """End a drag, or a pause of changes by wheel or keys."""
        self._still.stop()
        if self.dragging:
            self.dragging = False
            self.drag_ended.emit()


def _title(text: str) -> QLabel:
    label = make_bold(QLabel(text))
    label.setContentsMargins(0, 6, 0, 0)
    return label
