"""Labelled controls for the parameters of all methods, derived from the parameter types."""

from collections.abc import Mapping
from functools import partial

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QFormLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.core.params import Setting, Value, list_settings, replace_value
from widgets.stages.parameter_controls import (
    ParameterControl,
    describe_setting,
    format_label,
    make_control,
    mark_unused,
)
from widgets.style.base import FixedSizeLabel, VerticalScrollArea
from widgets.style.styling import fill, make_bold, make_icon_button, set_spacing

# width of all labels, which wrap: a form takes the room of wider ones from the values
_LABEL_PX = 112


class ParametersPanel(VerticalScrollArea):
    """One group per method; `params_edited(key, params)` carries the complete new parameters."""

    params_edited = pyqtSignal(str, object)
    # key of the slider that is held: its values are drafts; "" = let go
    slider_held = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("parameters")
        self._body = QWidget()
        self._layout = QVBoxLayout(self._body)
        self._layout.setContentsMargins(6, 4, 6, 4)
        self._layout.addStretch(1)
        self.setWidget(self._body)
        self._params: dict[str, object] = {}
        self._controls: dict[str, dict[str, ParameterControl]] = {}
        self._groups: dict[str, QWidget] = {}
        self._titles: dict[str, str] = {}
        self._heads: dict[str, QWidget] = {}
        # rows of one kind of sensor only
        self._only: list[tuple[str, QFormLayout, QWidget, Setting]] = []

    def add_group(self, key: str, title: str, params: object, tip: str = "") -> None:
        """Add the controls of a method with a tooltip; nothing for a method without parameters."""
        self._params[key] = params
        self._titles[key] = title
        group, form = self._group(key, title, tip)
        self._controls[key] = {}
        for name, (value, setting) in list_settings(params).items():
            control = make_control(value, setting, partial(self._emit_edited, key, name))
            self._controls[key][name] = control
            label = QLabel(format_label(setting))
            label.setWordWrap(True)
            label.setFixedWidth(_LABEL_PX)
            tip = describe_setting(setting, f"{key.partition('/')[0]}.{name}")
            label.setToolTip(tip)
            control.widget.setToolTip(tip)
            for slider in control.sliders:
                slider.sliderPressed.connect(partial(self.slider_held.emit, key))
                slider.sliderReleased.connect(partial(self.slider_held.emit, ""))
            control.set_names(f"{key}.{name}", format_label(setting))
            form.addRow(label, control.widget)
            if setting.sensor_kind:
                self._only.append((key, form, control.widget, setting))
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

        `kinds` maps a method's key to the kind of its sensor ("" = unknown); settings of other
        kinds are hidden.
        """
        for key, form, control, setting in self._only:
            form.setRowVisible(control, setting.applies_to(kinds.get(key, "")))
        for key, group in self._groups.items():
            group.setVisible(key in kinds and bool(self._controls[key]))
        self.updateGeometry()

    def show_unavailable(self, key: str, reasons: Mapping[str, str]) -> None:
        """Grey out the parameters of a method that cannot act; `reasons` is name -> why."""
        for name, control in self._controls.get(key, {}).items():
            control.set_unavailable(reasons.get(name, ""))

    def show_unused(self, key: str, reason: str) -> None:
        """Strike out the title of a method that did not answer, with the reason; "" = it did."""
        if key in self._heads:
            mark_unused(self._heads[key], reason)

    def list_shown(self) -> list[tuple[str, Setting, QWidget]]:
        """List (group title, setting, control) of every parameter of the route."""
        return [
            (self._titles[key], setting, self._controls[key][name].widget)
            for key, group in self._groups.items()
            if not group.isHidden()
            for name, (_, setting) in list_settings(self._params[key]).items()
            if not self._controls[key][name].widget.isHidden()
        ]

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
        name = FixedSizeLabel(title)
        name.setToolTip(f"{title}\n{tip}" if tip else title)
        make_bold(name)
        self._heads[key] = name
        button = make_icon_button("reset", f"reset_{key}", f"Reset {title.lower()} to its defaults")
        button.setAccessibleName(f"reset {key}")
        button.clicked.connect(lambda: self.reset(key))
        form = QFormLayout()
        fill(outer, fill(head, (name, 1), button), form)
        form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.DontWrapRows)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.setContentsMargins(4, 0, 0, 0)
        form.setSpacing(3)
        return group, form

    def _emit_edited(self, key: str, name: str, value: Value) -> None:
        params = replace_value(self._params[key], name, value)
        if params != self._params[key]:
            self._params[key] = params
            self.params_edited.emit(key, params)
