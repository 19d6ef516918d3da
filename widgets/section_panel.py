"""Section tab: plot, end points as numbers, and a table of the curves."""

from PyQt6.QtCore import QSignalBlocker, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QVBoxLayout,
    QWidget,
)

from pipeline.translation.cross_section import CrossSection, SectionLine, format_csv
from widgets.base import ChoiceBox, FixedSizeLabel
from widgets.number_box import NumberBox
from widgets.section_plot import SectionPlot
from widgets.styling import copy_text, fill, make_button, make_command_button, set_spacing

_NAMES = ("A, mm", "", "B, mm", "")
_TIPS = ("across", "down", "across", "down")
_PLACES = {"": "both sensors", "source": "source", "target": "target"}
_REACH_MM, _STEP_MM, _DIGITS = 999.0, 0.1, 2
_HOW = "{:.2f} mm; Shift and drag draws a new line, drag A or B, P and arrow keys move it"
_OFF = "no line"


class SectionPanel(QWidget):
    """Shows a `CrossSection`; emits line positions that the user types."""

    line_typed = pyqtSignal(object)  # Line

    def __init__(self) -> None:
        super().__init__()
        self.plot, self.message = SectionPlot(), FixedSizeLabel(_OFF)
        self.line: SectionLine | None = None
        tip = "Copy the curves as a table: mm along the line, and mm of indentation for every stage"
        self.copy = make_button("Copy CSV", "section_copy", tip)
        tip = "Copy the command line that writes this table"
        self.command = make_button("Copy command", "section_command", tip)
        self._head = set_spacing(QHBoxLayout(), 5)
        self.ends: list[NumberBox] = []
        for k, (name, tip) in enumerate(zip(_NAMES, _TIPS, strict=True)):
            box, end = NumberBox(), "AB"[k // 2]
            box.setObjectName(f"section_{end.lower()}_{'xy'[k % 2]}")
            box.setAccessibleName(f"{end}, {'xy'[k % 2]} in mm")
            box.setRange(-_REACH_MM, _REACH_MM)
            box.setDecimals(_DIGITS)
            box.setSingleStep(_STEP_MM)
            box.setToolTip(f"How far {tip} from the source camera's axis the line's end {end} lies, on the gel")
            box.setKeyboardTracking(False)
            box.valueChanged.connect(self._emit_typed)
            fill(self._head, *([QLabel(name)] if name else []), box)
            self.ends.append(box)
        self.sensor_box = ChoiceBox("section_place", "sensor of the curves", _PLACES)
        self.sensor_box.setToolTip("Sensor of the curves; a gel is indented less than a bubble")
        self.sensor_box.chosen.connect(self.plot.show_sensor_role)
        fill(self._head, self.sensor_box, (self.message, 1), self.copy, self.command)
        fill(set_spacing(QVBoxLayout(self), 2, (6, 4, 6, 2)), self._head, (self.plot, 1))
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
