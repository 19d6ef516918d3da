"""One axis of an alignment: a slider and a spin box."""

from PyQt6.QtCore import QObject, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import QSlider

from pipeline.sensors.alignment import Axis
from pipeline.translation.alignment.nudge import axis_unit
from widgets.style.base import FIXED, YIELDS, NumberBox
from widgets.style.styling import ThemedLabel, make_bold, name_widget

# slider steps per unit; range of the slider to either side, and of the spin box; its step and
# digits; sign of the unit
_UNITS = {"mm": (20, 5, 200.0, 0.05, 3, " mm"), "deg": (10, 10, 179.0, 0.1, 2, "°")}


class AxisRow(QObject):
    """Label, slider and spin box of one axis, which show the same number."""

    value_changed = pyqtSignal(str, float)  # axis, mm or degrees

    def __init__(self, axis: Axis, parent: QObject) -> None:
        super().__init__(parent)
        self.axis: Axis = axis
        unit = axis_unit(axis)
        self._per_unit, reach, farthest, self._step, digits, self._sign = _UNITS[unit]
        self.label = make_bold(ThemedLabel(lambda inks: inks.axes["xyz".index(axis[-1])], axis))
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(-reach * self._per_unit, reach * self._per_unit)
        self.slider.setPageStep(self._per_unit)
        self.slider.setSizePolicy(YIELDS, FIXED)
        self.box = NumberBox(-farthest, farthest, self._step, digits)
        self.box.setSuffix(self._sign)
        self.box.setAlignment(Qt.AlignmentFlag.AlignRight)
        way = "translation along" if unit == "mm" else "rotation about"
        what = f"{way} {axis[-1]}, {'millimetres' if unit == 'mm' else 'degrees'}"
        name_widget(self.slider, f"align_{axis}_slider", what)
        name_widget(self.box, f"align_{axis}_box", what)
        self.show_frame_name("target")
        self.slider.valueChanged.connect(self._slid)
        self.box.valueChanged.connect(self._apply_typed)

    def show_frame_name(self, frame: str) -> None:
        """Show the name of the frame that the axes belong to."""
        tip = f"Translate the touch along {self.axis[-1]} of the {frame} frame, mm"
        if axis_unit(self.axis) != "mm":
            tip = (
                f"Rotate the touch about {self.axis[-1]} of the {frame} frame, degrees, about the "
                "centre of the contact; the three form a rotation vector"
            )
        tip += "; offset from the open alignment. Wheel and arrow keys: steps of "
        tip += f"{self._step:g}{self._sign}"
        for widget in (self.label, self.slider, self.box):
            widget.setToolTip(tip)

    def show_value(self, value: float) -> None:
        """Show a number without emitting a signal."""
        with QSignalBlocker(self.slider), QSignalBlocker(self.box):
            if not self.slider.isSliderDown():
                self.slider.setValue(round(value * self._per_unit))
            self.box.setValue(value)

    def _slid(self, position: int) -> None:
        value = position / self._per_unit
        with QSignalBlocker(self.box):
            self.box.setValue(value)
        self.value_changed.emit(self.axis, value)

    def _apply_typed(self, value: float) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(round(value * self._per_unit))
        self.value_changed.emit(self.axis, value)
