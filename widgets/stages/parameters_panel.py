"""Labelled controls for the parameters of all methods, derived from the parameter types."""

from collections.abc import Mapping
from functools import partial

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QFormLayout, QLabel, QSizePolicy, QVBoxLayout, QWidget

from pipeline.core.params import Setting, Value, list_settings, replace_value
from widgets.stages.parameter_controls import (
    ParameterControl,
    describe_setting,
    format_label,
    make_control,
)
from widgets.style.base import VerticalScrollArea
from widgets.style.styling import (
    fill,
    make_bold,
    make_column,
    make_icon_button,
    make_row,
    make_text,
    set_spacing,
)

# width of all labels, which wrap: a form takes the room of wider ones from the values
_LABEL_PX = 112
ALL_STAGES = "*"


class ParametersPanel(VerticalScrollArea):
    """One group per method of one stage or of all, and the parameters that stay in sight of the
    others.

    `params_edited(key, params)` carries the complete new parameters.
    """

    params_edited = pyqtSignal(str, object)
    # key of the slider that is held: its values are drafts; "" = let go
    slider_held = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("parameters")
        body = QWidget()
        self._layout = fill(QVBoxLayout(body), 1)
        self._layout.setContentsMargins(6, 4, 6, 4)
        self.setWidget(body)
        self._params: dict[str, object] = {}
        self._controls: dict[str, dict[str, ParameterControl]] = {}
        self._groups: dict[str, QWidget] = {}
        self._titles: dict[str, str] = {}
        self._heads: dict[str, tuple[QWidget, str]] = {}  # with its tooltip
        self._rows: list[tuple[str, QFormLayout, QWidget, Setting]] = []
        self._kinds: Mapping[str, str] = {}  # method key -> kind of its sensor, of the route
        self._stage = ALL_STAGES

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
            tip = describe_setting(setting)
            label.setToolTip(tip)
            control.widget.setToolTip(tip)
            for slider in control.sliders:
                slider.sliderPressed.connect(partial(self.slider_held.emit, key))
                slider.sliderReleased.connect(partial(self.slider_held.emit, ""))
            control.set_names(f"{key}.{name}", format_label(setting))
            form.addRow(label, control.widget)
            self._rows.append((key, form, control.widget, setting))
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
        """Offer the groups of the methods of the route only.

        `kinds` maps a method's key to the kind of its sensor ("" = unknown); settings of other
        kinds are hidden.
        """
        if kinds != self._kinds:
            self._kinds = kinds
            self._arrange()

    def show_stage(self, stage: str) -> None:
        """Show the parameters of one stage, or of `ALL_STAGES`."""
        if stage != self._stage:
            self._stage = stage
            self._arrange()

    def _arrange(self) -> None:
        shown: set[str] = set()
        for key, form, control, setting in self._rows:
            is_chosen = self._stage in (ALL_STAGES, key.partition("/")[0])
            is_shown = (is_chosen or bool(setting.pinned)) and self._applies(key, setting)
            form.setRowVisible(control, is_shown)
            shown |= {key} if is_shown else set()
        for key, group in self._groups.items():
            group.setVisible(key in shown)
        self.updateGeometry()

    def _applies(self, key: str, setting: Setting) -> bool:
        return key in self._kinds and setting.applies_to(self._kinds[key])

    def show_unavailable(self, key: str, reasons: Mapping[str, str]) -> None:
        """Grey out the parameters of a method that cannot act; `reasons` is name -> why."""
        for name, control in self._controls.get(key, {}).items():
            reason = reasons.get(name, "")
            _, setting = list_settings(self._params[key])[name]
            control.widget.setEnabled(not reason)
            control.widget.setToolTip(reason or describe_setting(setting))

    def show_unused(self, key: str, reason: str) -> None:
        """Strike out the title of a method that did not answer, with the reason; "" = it did."""
        if key in self._heads:
            head, tip = self._heads[key]
            font = head.font()
            font.setStrikeOut(bool(reason))
            head.setFont(font)
            head.setToolTip(f"without effect on this frame: {reason}" if reason else tip)

    def list_offered(self) -> list[tuple[str, Setting, QWidget]]:
        """List (group title, setting, control) of every parameter of the route."""
        return [
            (self._titles[key], setting, control)
            for key, _, control, setting in self._rows
            if self._applies(key, setting)
        ]

    def reveal(self, control: QWidget) -> None:
        """Show a control, with the parameters of its stage."""
        if control.isHidden() or not control.isVisible():
            key = next(key for key, _, other, _ in self._rows if other is control)
            self.show_stage(key.partition("/")[0])
        self.ensureWidgetVisible(control)

    def reset(self, key: str) -> None:
        """Reset a method to its defaults."""
        params = type(self._params[key])()
        if params != self._params[key]:
            self.show_params(key, params)
            self.params_edited.emit(key, params)

    def _group(self, key: str, title: str, tip: str) -> tuple[QWidget, QFormLayout]:
        group = QWidget()
        outer = make_column(3, around_px=(0, 2, 0, 6), on=group)
        name = make_bold(make_text())
        name.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        name.setText(title)
        self._heads[key] = name, f"{title}\n{tip}" if tip else title
        self.show_unused(key, "")
        button = make_icon_button("reset", f"reset_{key}", f"Reset {title.lower()} to its defaults")
        button.setAccessibleName(f"reset {key}")
        button.clicked.connect(lambda: self.reset(key))
        form = set_spacing(QFormLayout(), 3, (4, 0, 0, 0))
        fill(outer, make_row(6, (name, 1), button), form)
        form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.DontWrapRows)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        return group, form

    def _emit_edited(self, key: str, name: str, value: Value) -> None:
        params = replace_value(self._params[key], name, value)
        if params != self._params[key]:
            self._params[key] = params
            self.params_edited.emit(key, params)
