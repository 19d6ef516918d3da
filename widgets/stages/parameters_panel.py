"""Labelled controls for the parameters of all methods, derived from the parameter types."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QFormLayout, QLabel, QSlider, QWidget

from pipeline.core.params import Setting, Value, list_settings, replace_value
from widgets.stages.parameter_controls import (
    ParameterControl,
    describe_setting,
    format_label,
    make_control,
)
from widgets.style.base import PREFERS, YIELDS, VerticalScrollArea
from widgets.style.styling import (
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


@dataclass(slots=True, kw_only=True)
class _Group:
    """The controls of one method, and what they show."""

    title: str
    params: object
    widget: QWidget
    head: QLabel
    tip: str  # of the head
    form: QFormLayout
    rows: dict[str, tuple[ParameterControl, Setting]] = field(
        default_factory=dict[str, tuple[ParameterControl, Setting]]
    )


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
        self._layout = make_column(6, 1, around_px=(6, 4, 6, 4), on=body)
        self.setWidget(body)
        self._groups: dict[str, _Group] = {}
        self._kinds: Mapping[str, str] = {}  # method key -> kind of its sensor, of the route
        self._stage = ALL_STAGES

    def add_group(self, key: str, title: str, params: object, tip: str = "") -> None:
        """Add the controls of a method with a tooltip; nothing for a method without parameters."""
        group = self._groups[key] = self._make_group(key, title, params, tip)
        for name, (value, setting) in list_settings(params).items():
            control = make_control(value, setting, partial(self._emit_edited, key, name))
            group.rows[name] = control, setting
            label = make_text()
            label.setText(format_label(setting))
            label.setFixedWidth(_LABEL_PX)
            for widget in (label, control.widget):
                widget.setToolTip(describe_setting(setting))
            control.widget.setObjectName(f"{key}.{name}")
            for part in (control.widget, *control.widget.findChildren(QWidget)):
                part.setAccessibleName(format_label(setting))
            for slider in control.widget.findChildren(QSlider):
                slider.sliderPressed.connect(partial(self.slider_held.emit, key))
                slider.sliderReleased.connect(partial(self.slider_held.emit, ""))
            group.form.addRow(label, control.widget)
        group.widget.setVisible(bool(group.rows))
        self.show_unused(key, "")
        self._layout.insertWidget(self._layout.count() - 1, group.widget)

    def show_params(self, key: str, params: object) -> None:
        """Show these values without emitting a signal."""
        group = self._groups.get(key)
        if group is not None and params != group.params:
            group.params = params
            for name, (value, _) in list_settings(params).items():
                group.rows[name][0].show(value)

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
        for key, group in self._groups.items():
            is_chosen = self._stage in (ALL_STAGES, key.partition("/")[0])
            shown = [
                (is_chosen or bool(setting.pinned)) and self._applies(key, setting)
                for _, setting in group.rows.values()
            ]
            for (control, _), is_shown in zip(group.rows.values(), shown, strict=True):
                group.form.setRowVisible(control.widget, is_shown)
            group.widget.setVisible(any(shown))
        self.updateGeometry()

    def _applies(self, key: str, setting: Setting) -> bool:
        return key in self._kinds and setting.applies_to(self._kinds[key])

    def show_unavailable(self, key: str, reasons: Mapping[str, str]) -> None:
        """Grey out the parameters of a method that cannot act; `reasons` is name -> why."""
        rows = self._groups[key].rows if key in self._groups else {}
        for name, (control, setting) in rows.items():
            reason = reasons.get(name, "")
            control.widget.setEnabled(not reason)
            control.widget.setToolTip(reason or describe_setting(setting))

    def show_unused(self, key: str, reason: str) -> None:
        """Strike out the title of a method that did not answer, with the reason; "" = it did."""
        group = self._groups.get(key)
        if group is not None:
            font = group.head.font()
            font.setStrikeOut(bool(reason))
            group.head.setFont(font)
            words = f"without effect on this frame: {reason}"
            group.head.setToolTip(words if reason else group.tip)

    def list_offered(self) -> list[tuple[str, Setting, QWidget]]:
        """List (group title, setting, control) of every parameter of the route."""
        return [
            (group.title, setting, control.widget)
            for key, group in self._groups.items()
            for control, setting in group.rows.values()
            if self._applies(key, setting)
        ]

    def reveal(self, control: QWidget) -> None:
        """Show a control, with the parameters of its stage."""
        if not control.isVisible():
            key, _, _ = control.objectName().partition(".")
            self.show_stage(key.partition("/")[0])
        self.ensureWidgetVisible(control)

    def reset(self, key: str) -> None:
        """Reset a method to its defaults."""
        params = type(self._groups[key].params)()
        if params != self._groups[key].params:
            self.show_params(key, params)
            self.params_edited.emit(key, params)

    def _make_group(self, key: str, title: str, params: object, tip: str) -> _Group:
        head = make_bold(make_text())
        head.setSizePolicy(YIELDS, PREFERS)
        head.setText(title)
        button = make_icon_button("reset", f"reset_{key}", f"Reset {title.lower()} to its defaults")
        button.setAccessibleName(f"reset {key}")
        button.clicked.connect(lambda: self.reset(key))
        form = set_spacing(QFormLayout(), 3, (4, 0, 0, 0))
        form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.DontWrapRows)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        widget = QWidget()
        make_column(3, make_row(6, (head, 1), button), form, around_px=(0, 2, 0, 6), on=widget)
        tip = f"{title}\n{tip}" if tip else title
        return _Group(title=title, params=params, widget=widget, head=head, tip=tip, form=form)

    def _emit_edited(self, key: str, name: str, value: Value) -> None:
        group = self._groups[key]
        params = replace_value(group.params, name, value)
        if params != group.params:
            group.params = params
            self.params_edited.emit(key, params)
