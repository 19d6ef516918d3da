"""Controls for single parameters, derived from their type and `Setting`."""

import math
from collections.abc import Callable
from typing import Any

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QLineEdit,
    QSlider,
    QSpinBox,
    QWidget,
)

from pipeline.core.frozen import frozen
from pipeline.core.params import Setting, Value
from widgets.style.base import FIXED, PREFERS, ChoiceBox, NumberBox
from widgets.style.styling import make_row

_SLIDER_STEPS = 400
_SLIDER_PX = 40
_GAP_PX = 6
# integer ranges up to the first have a linear slider, up to the second one that favours small
# values
_MANY = 200
_TOO_MANY = 10_000
_BEND = 3.0
_WIDEST = 1e9  # stands for "no limit" in a spin box


@frozen
class ParameterControl:
    """One parameter on screen: its widget and a setter for its value, which emits nothing."""

    widget: QWidget
    show: Callable[[Value], None]


def make_control(
    value: Value, setting: Setting, edited: Callable[[Value], None]
) -> ParameterControl:
    """Return the control of a parameter of this type; `edited` is called with a new value."""
    if isinstance(value, bool):
        return _switch(value, edited)
    if setting.choices:
        return _choice(str(value), setting, edited)
    if isinstance(value, int):
        return _whole(value, setting, edited)
    if isinstance(value, float):
        return _number(value, setting, edited)
    return _text(value, edited)


def describe_setting(setting: Setting) -> str:
    """Return the tooltip: help, range and source."""
    words = _range(setting)
    tip = (setting.help or setting.label) + (f" ({words})" if words else "")
    return f"{tip}\nsource: {setting.source}" if setting.source else tip


def format_label(setting: Setting) -> str:
    """Return the label with its unit."""
    is_named = not setting.unit or setting.unit in setting.label.lower()
    return setting.label if is_named else f"{setting.label}, {setting.unit}"


def _range(setting: Setting) -> str:
    """Return the allowed range with its unit."""
    unit = f" {setting.unit}" if setting.unit else ""
    if setting.choices:
        return ""  # which the list shows
    if math.isfinite(setting.low) and math.isfinite(setting.high):
        return f"{setting.low:g} to {setting.high:g}{unit}"
    return f"in{unit}" if unit else ""


def _quiet(box: QWidget, put: Callable[[Any], object]) -> ParameterControl:
    """Return a control whose setter emits no signal."""

    def show(new: Value) -> None:
        with QSignalBlocker(box):
            put(new)

    return ParameterControl(widget=box, show=show)


def _switch(value: bool, edited: Callable[[Value], None]) -> ParameterControl:
    box = QCheckBox()
    box.setChecked(value)
    box.toggled.connect(edited)
    return _quiet(box, box.setChecked)


def _choice(value: str, setting: Setting, edited: Callable[[Value], None]) -> ParameterControl:
    box = ChoiceBox(
        "", setting.label, dict(zip(setting.choices, setting.choice_titles, strict=True))
    )
    box.setCurrentText(value)
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContentsOnFirstShow)
    box.setSizePolicy(PREFERS, FIXED)
    box.currentTextChanged.connect(edited)
    return _quiet(box, box.setCurrentText)


def _text(value: str, edited: Callable[[Value], None]) -> ParameterControl:
    line = QLineEdit(value)
    line.editingFinished.connect(lambda: edited(line.text()))
    return _quiet(line, line.setText)


def _whole(value: int, setting: Setting, edited: Callable[[Value], None]) -> ParameterControl:
    box = QSpinBox()
    box.setRange(int(max(setting.low, -_WIDEST)), int(min(setting.high, _WIDEST)))
    box.setSingleStep(max(1, int(setting.step)))
    bend = _BEND if _MANY <= setting.high - setting.low <= _TOO_MANY else 0.0
    return _with_slider(box, lambda new: box.setValue(round(new)), value, setting, edited, bend)


def _number(value: float, setting: Setting, edited: Callable[[Value], None]) -> ParameterControl:
    low = max(setting.low, -_WIDEST)
    high = min(setting.high, _WIDEST)
    is_bounded = math.isfinite(setting.low) and math.isfinite(setting.high)
    step = setting.step or ((high - low) / 10 if is_bounded else 0.1)
    box = NumberBox(low, high, step, max(2, min(6, 2 - math.floor(math.log10(step)))))
    return _with_slider(box, box.setValue, value, setting, edited, float(is_bounded))


def _with_slider(
    box: QSpinBox | QDoubleSpinBox,
    put: Callable[[float], object],
    value: float,
    setting: Setting,
    edited: Callable[[Value], None],
    bend: float,
) -> ParameterControl:
    """Return a spin box with a slider whose values grow by the power `bend`; without one for 0."""
    box.setKeyboardTracking(False)
    put(value)
    box.valueChanged.connect(edited)
    if not bend:
        return _quiet(box, put)
    both = QWidget()
    slider = QSlider(Qt.Orientation.Horizontal)
    low = setting.low
    span = setting.high - setting.low
    slider.setRange(0, _SLIDER_STEPS)
    slider.setMinimumWidth(_SLIDER_PX)

    def place_slider(new: float) -> None:
        with QSignalBlocker(slider):
            slider.setValue(round(((new - low) / span) ** (1 / bend) * _SLIDER_STEPS))

    def show(new: Value) -> None:
        with QSignalBlocker(box):
            put(float(new))
        place_slider(float(new))

    def apply_dragged(at: int) -> None:
        put(low + span * (at / _SLIDER_STEPS) ** bend)

    place_slider(value)
    box.valueChanged.connect(place_slider)
    slider.valueChanged.connect(apply_dragged)
    make_row(_GAP_PX, (slider, 1), box, on=both)
    return ParameterControl(widget=both, show=show)
