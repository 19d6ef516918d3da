"""The section line: its ends on an image, and its height curves in a tab."""

from PyQt6.QtCore import QEvent, QObject, QPointF, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QKeyEvent, QMouseEvent
from PyQt6.QtWidgets import QLabel, QWidget

from pipeline.translation.cross_section import CrossSection, SectionLine, format_csv
from widgets.stages.section_plot import SectionPlot
from widgets.style.base import ChoiceBox, FixedSizeLabel, NumberBox
from widgets.style.styling import (
    copy_text,
    fill,
    make_button,
    make_column,
    make_command_button,
    make_row,
    name_widget,
)
from widgets.views.canvas import Canvas
from widgets.views.preview_key_filter import get_arrow_step_px

_NAMES = ("A, mm", "", "B, mm", "")
_TIPS = ("across", "down", "across", "down")
_PLACES = {"": "both sensors", "source": "source", "target": "target"}
_REACH_MM = 999.0
_STEP_MM = 0.1
_DIGITS = 2
_HOW = "{:.2f} mm; Shift and drag draws a new line, drag A or B, P and arrow keys move it"
_OFF = "no line"
_NEAR_PX = 9.0
_Modifier = Qt.KeyboardModifier
_Ends = tuple[QPointF, QPointF]


class SectionPanel(QWidget):
    """Shows a `CrossSection`; emits line positions that the user types."""

    line_typed = pyqtSignal(object)  # Line

    def __init__(self) -> None:
        super().__init__()
        self.plot = SectionPlot()
        self.message = FixedSizeLabel(_OFF)
        self.line: SectionLine | None = None
        self.copy = make_button(
            "Copy CSV",
            "section_copy",
            "Copy the curves as a table: mm along the line, and mm of indentation for every stage",
        )
        tip = "Copy the command line that writes this table"
        self.command = make_button("Copy command", "section_command", tip)
        self._head = make_row(5)
        self.ends: list[NumberBox] = []
        for k, (name, tip) in enumerate(zip(_NAMES, _TIPS, strict=True)):
            end, axis = "AB"[k // 2], "xy"[k % 2]
            box = name_widget(
                NumberBox(-_REACH_MM, _REACH_MM, _STEP_MM, _DIGITS),
                f"section_{end.lower()}_{axis}",
                f"{end}, {axis} in mm",
                f"How far {tip} from the source camera's axis the line's end {end} lies, on the "
                "gel",
            )
            box.valueChanged.connect(self._emit_typed)
            fill(self._head, *([QLabel(name)] if name else []), box)
            self.ends.append(box)
        self.sensor_box = ChoiceBox("section_place", "sensor of the curves", _PLACES)
        self.sensor_box.setToolTip("Sensor of the curves; a gel is indented less than a bubble")
        self.sensor_box.chosen.connect(self.plot.show_sensor_role)
        fill(self._head, self.sensor_box, (self.message, 1), self.copy, self.command)
        make_column(2, self._head, (self.plot, 1), around_px=(6, 4, 6, 2), on=self)
        self.copy.clicked.connect(self._copy)
        self.show_line(None)

    def add_command(self, action: QAction) -> None:
        """Add a button before the numbers."""
        self._head.insertWidget(0, make_command_button(action))

    def show_line(self, line: SectionLine | None) -> None:
        """Show the end points without emitting a signal."""
        self.line = line
        for box, value in zip(self.ends, (0.0,) * 4 if line is None else line.plain, strict=True):
            with QSignalBlocker(box):
                box.setValue(value)
            box.setEnabled(line is not None)
        self.message.setText(_OFF if line is None else _HOW.format(line.length_mm))
        self.message.setToolTip(self.message.text())
        if line is None:
            self.show_section(None)

    def show_section(self, section: CrossSection | None) -> None:
        """Show the curves along the line."""
        self.plot.show_section(section)
        for button in (self.copy, self.command):
            button.setEnabled(section is not None)

    def _emit_typed(self) -> None:
        x0, y0, x1, y1 = (box.value() for box in self.ends)
        self.line_typed.emit(SectionLine(begin_mm=(x0, y0), end_mm=(x1, y1)))

    def _copy(self) -> None:
        if self.plot.section is not None:
            copy_text(format_csv(self.plot.section))


class SectionLineTool(QObject):
    """Paints the line on a canvas and takes the drags of it; listens only while there is a line."""

    line_moved = pyqtSignal(QPointF, QPointF)  # start and end, in image pixels

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._canvas = canvas
        self._fixed: QPointF | None = None  # the fixed end during a drag
        self._begins = False  # whether the dragged end is the first

    def show_line(self, ends: _Ends | None) -> None:
        """Show the line, in image pixels; None removes it."""
        if ends is None:
            self._canvas.removeEventFilter(self)
            self._fixed = None
        elif self._canvas.line is None:
            self._canvas.installEventFilter(self)
        self._canvas.show_line(ends)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Handle drags and arrow keys of the line before those of the canvas."""
        taken = False
        if isinstance(a1, QMouseEvent):
            taken = self._drag(a1)
        elif isinstance(a1, QKeyEvent) and a1.type() == QEvent.Type.KeyPress:
            taken = self._step(a1)
        return taken or super().eventFilter(a0, a1)

    def _drag(self, event: QMouseEvent) -> bool:
        kind = event.type()
        there = self._canvas.to_image(event.position())
        if kind == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton:
            if event.modifiers() & _Modifier.ShiftModifier:
                self._fixed, self._begins = there, False
                return True
            return self._take(event.position())
        if self._fixed is None:
            return False
        if kind == QEvent.Type.MouseMove:
            self.line_moved.emit(*((there, self._fixed) if self._begins else (self._fixed, there)))
        elif kind == QEvent.Type.MouseButtonRelease:
            self._fixed = None
        else:
            return False
        return True

    def _step(self, key: QKeyEvent) -> bool:
        step = QPointF(*get_arrow_step_px(key))
        if step.isNull() or self._canvas.line is None:
            return False
        begin, end = self._canvas.line
        if not key.modifiers() & _Modifier.AltModifier:
            begin = begin + step
        if not key.modifiers() & _Modifier.ControlModifier:
            end = end + step
        self.line_moved.emit(begin, end)
        return True

    def _take(self, at: QPointF) -> bool:
        """Take the end at a position on the screen, B before A."""
        begin, end = self._canvas.line or (QPointF(), QPointF())
        for own, other in ((end, begin), (begin, end)):
            if (self._canvas.to_screen(own) - at).manhattanLength() < _NEAR_PX:
                self._fixed, self._begins = QPointF(other), own is begin
                return True
        return False
