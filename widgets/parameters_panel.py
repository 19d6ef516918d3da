"""Labelled controls for the parameters of all methods, derived from the parameter types."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QScrollArea,
    QSizePolicy,
    QSlider,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from pipeline.base.params import Setting, Value, list_settings, replace_value
from widgets.styling import make_bold, make_icon_button, set_spacing

_SLIDER_STEPS = 400
_MANY, _TOO_MANY, _BEND = (
    200,
    10_000,
    3.0,
)  # integer ranges up to the first have a linear slider, up to the second one that favours small values
_WIDEST = 1e9  # stands for "no limit" in a spin box


@dataclass(frozen=True, slots=True, kw_only=True)
class _Control:
    """One parameter on screen: its widget and a setter for its value."""

    widget: QWidget
    show: Callable[[Value], None]


class ParametersPanel(QScrollArea):
    """One group per method; `params_edited(key, params)` carries the complete new parameters."""

    params_edited = pyqtSignal(str, object)
    drag_ended = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._body = QWidget()
        self._layout = QVBoxLayout(self._body)
        self._layout.setContentsMargins(6, 4, 6, 4)
        self._layout.addStretch(1)
        self.setWidget(self._body)
        self.dragged_key = ""  # key of the slider that is held: its values are drafts
        self._params: dict[str, object] = {}
        self._controls: dict[str, dict[str, _Control]] = {}
        self._groups: dict[str, QWidget] = {}
        self._only: list[tuple[str, QFormLayout, QWidget, Setting]] = []  # rows of one kind of sensor only

    def add_group(self, key: str, title: str, params: object, tip: str = "") -> None:
        """Add the controls of a method with a tooltip; nothing for a method without parameters."""
        self._params[key] = params
        group, form = self._group(key, title, tip)
        self._controls[key] = {}
        for name, (value, told) in list_settings(params).items():
            control = self._control(key, name, value, told)
            self._controls[key][name] = control
            label = QLabel(_label(told))
            label.setWordWrap(True)
            called = f"{key.partition('/')[0]}.{name}"  # its name on the command line
            tip = f"{told.help or told.label} ({called}{_range(told)})"
            tip += f"\nsource: {told.source}" if told.source else ""
            label.setToolTip(tip)
            control.widget.setToolTip(tip)
            for slider in control.widget.findChildren(QSlider):
                slider.sliderPressed.connect(partial(self._hold, key))
                slider.sliderReleased.connect(partial(self._hold, ""))
            control.widget.setAccessibleName(told.label)
            control.widget.setObjectName(f"{key}.{name}")
            form.addRow(label, control.widget)
            if told.sensor_kind:
                self._only.append((key, form, control.widget, told))
        group.setVisible(bool(self._controls[key]))
        self._groups[key] = group
        self._layout.insertWidget(self._layout.count() - 1, group)

    def show_params(self, key: str, params: object) -> None:
        """Show these values without emitting a signal."""
        if key not in self._controls or params == self._params.get(key):
            return
        self._params[key] = params
        for name, (value, _) in list_settings(params).items():
            self._controls[key][name].show(value)

    def show_groups(self, kinds: Mapping[str, str]) -> None:
        """Show the groups of the methods of the route only.

        `kinds` maps a method's key to the kind of its sensor ("" = unknown); settings of other kinds are hidden.
        """
        for key, form, control, told in self._only:
            form.setRowVisible(control, told.applies_to(kinds.get(key, "")))
        for key, group in self._groups.items():
            group.setVisible(key in kinds and bool(self._controls[key]))

    def reset(self, key: str) -> None:
        """Reset a method to its defaults."""
        params = type(self._params[key])()
        if params != self._params[key]:
            self.show_params(key, params)
            self.params_edited.emit(key, params)

    def _group(self, key: str, title: str, tip: str) -> tuple[QWidget, QFormLayout]:
        group = QWidget()
        outer = set_spacing(QVBoxLayout(group), 3, (0, 2, 0, 6))
        head = QHBoxLayout()
        name = QLabel(title)
        name.setToolTip(tip)
        make_bold(name)
        button = make_icon_button("reset", f"reset_{key}", f"Reset {title.lower()} to its defaults")
        button.setAccessibleName(f"reset {key}")
        button.clicked.connect(lambda: self.reset(key))
        head.addWidget(name, 1)
        head.addWidget(button)
        outer.addLayout(head)
        form = QFormLayout()
        form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.DontWrapRows)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.setContentsMargins(4, 0, 0, 0)
        form.setSpacing(3)
        outer.addLayout(form)
        return group, form

    @property
    def is_dragging(self) -> bool:
        """Whether a slider is held."""
        return bool(self.dragged_key)

    def _hold(self, key: str) -> None:
        self.dragged_key = key
        if not key:
            self.drag_ended.emit()

    def _emit_edited(self, key: str, name: str, value: Value) -> None:
        params = replace_value(self._params[key], name, value)
        if params != self._params[key]:
            self._params[key] = params
            self.params_edited.emit(key, params)

    def _control(self, key: str, name: str, value: Value, setting: Setting) -> _Control:
        def apply_edit(new: Value) -> None:
            self._emit_edited(key, name, new)

        if isinstance(value, bool):
            return _switch(value, apply_edit)
        if setting.choices:
            return _choice(str(value), setting, apply_edit)
        if isinstance(value, int):
            return _whole(value, setting, apply_edit)
        if isinstance(value, float):
            return _number(value, setting, apply_edit)
        return _text(value, apply_edit)


def _label(setting: Setting) -> str:
    """Return the label with its unit."""
    return (
        f"{setting.label}, {setting.unit}"
        if setting.unit and setting.unit not in setting.label.lower()
        else setting.label
    )


def _range(setting: Setting) -> str:
    """Return the allowed range with its unit."""
    unit = f" {setting.unit}" if setting.unit else ""
    if setting.choices:
        return f", {', '.join(setting.choices)}"
    if math.isfinite(setting.low) and math.isfinite(setting.high):
        return f", {setting.low:g} to {setting.high:g}{unit}"
    return f", in{unit}" if unit else ""


def _quiet(box: QWidget, put: Callable[[Any], object]) -> _Control:
    """Return a control whose setter emits no signal."""

    def show(new: Value) -> None:
        with QSignalBlocker(box):
            put(new)

    return _Control(widget=box, show=show)


def _switch(value: bool, edited: Callable[[Value], None]) -> _Control:
    box = QCheckBox()
    box.setChecked(value)
    box.toggled.connect(edited)
    return _quiet(box, box.setChecked)


def _choice(value: str, setting: Setting, edited: Callable[[Value], None]) -> _Control:
    box = QComboBox()
    box.addItems(list(setting.choices))
    box.setCurrentText(value)
    box.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
    box.currentTextChanged.connect(edited)
    return _quiet(box, box.setCurrentText)


def _text(value: str, edited: Callable[[Value], None]) -> _Control:
    line = QLineEdit(value)
    line.editingFinished.connect(lambda: edited(line.text()))
    return _quiet(line, line.setText)


def _whole(value: int, setting: Setting, edited: Callable[[Value], None]) -> _Control:
    box = QSpinBox()
    box.setRange(int(max(setting.low, -_WIDEST)), int(min(setting.high, _WIDEST)))
    box.setSingleStep(max(1, int(setting.step)))
    box.setKeyboardTracking(False)
    box.setValue(value)
    if not _MANY <= setting.high - setting.low <= _TOO_MANY:
        box.valueChanged.connect(edited)
        return _quiet(box, box.setValue)
    low, span = int(setting.low), setting.high - setting.low
    slider = QSlider(Qt.Orientation.Horizontal)
    slider.setRange(0, _SLIDER_STEPS)
    slider.setMinimumWidth(40)

    def place_slider(new: float) -> None:
        with QSignalBlocker(slider):
            slider.setValue(round(((new - low) / span) ** (1 / _BEND) * _SLIDER_STEPS))

    def apply_typed(new: int) -> None:
        place_slider(new)
        edited(new)

    def show(new: Value) -> None:
        with QSignalBlocker(box):
            box.setValue(int(new))
        place_slider(float(new))

    def apply_dragged(at: int) -> None:
        box.setValue(low + round(span * (at / _SLIDER_STEPS) ** _BEND))

    place_slider(value)
    box.valueChanged.connect(apply_typed)
    slider.valueChanged.connect(apply_dragged)
    return _Control(widget=_side_by_side(slider, box), show=show)


def _side_by_side(slider: QSlider | None, box: QWidget) -> QWidget:
    both = QWidget()
    row = QHBoxLayout(both)
    row.setContentsMargins(0, 0, 0, 0)
    if slider is not None:
        row.addWidget(slider, 1)
    row.addWidget(box, int(slider is None))
    return both


def _number(value: float, setting: Setting, edited: Callable[[Value], None]) -> _Control:
    """Return a spin box, with a slider where the range has two ends."""
    box = QDoubleSpinBox()
    low, high = max(setting.low, -_WIDEST), min(setting.high, _WIDEST)
    bounded = math.isfinite(setting.low) and math.isfinite(setting.high)
    step = setting.step or ((high - low) / 10 if bounded else 0.1)
    box.setDecimals(max(2, min(6, 2 - math.floor(math.log10(step)))))
    box.setRange(low, high)
    box.setSingleStep(step)
    box.setKeyboardTracking(False)
    box.setValue(value)
    slider = QSlider(Qt.Orientation.Horizontal)
    slider.setRange(0, _SLIDER_STEPS)
    slider.setMinimumWidth(40)

    def place_slider(new: float) -> None:
        if bounded:
            with QSignalBlocker(slider):
                slider.setValue(round((new - low) / (high - low) * _SLIDER_STEPS))

    def apply_typed(new: float) -> None:
        place_slider(new)
        edited(new)

    def apply_dragged(at: int) -> None:
        box.setValue(low + (high - low) * at / _SLIDER_STEPS)

    def show(new: Value) -> None:
        with QSignalBlocker(box):
            box.setValue(float(new))
        place_slider(float(new))

    place_slider(value)
    box.valueChanged.connect(apply_typed)
    slider.valueChanged.connect(apply_dragged)
    return _Control(widget=_side_by_side(slider if bounded else None, box), show=show)
