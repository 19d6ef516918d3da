"""The parameters of a stage that stay in sight, under its preview."""

from collections.abc import Iterable, Mapping
from functools import partial

from PyQt6.QtCore import QEvent, pyqtSignal
from PyQt6.QtWidgets import QBoxLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.core.params import Setting, Value, list_settings, replace_value
from widgets.stages.parameter_controls import (
    ParameterControl,
    describe_setting,
    make_control,
    mark_unused,
)
from widgets.style.base import EventListener, resize_font
from widgets.style.styling import fill, set_spacing

_LABEL_PX = 54
_ROW_PX = 22
_COMPACT_ROW_PX = 19
_NUMBER_LETTERS = 4
_SLIDERS_FROM_PX = 126  # width from which on a slider fits between label and number


class PinnedParameters(QWidget):
    """Controls of the parameters with a `pinned` label of all methods of a stage.

    What the method in use lacks, and what cannot act, is greyed out with the reason.
    """

    params_edited = pyqtSignal(str, object)  # key of the method, its complete new parameters
    slider_held = pyqtSignal(str)  # key of the method; "" = let go

    def __init__(self) -> None:
        super().__init__()
        self._key = ""
        self._params = object()
        self._height_px = 0
        # one per range; the shown one is in `_shown`
        self._controls: dict[str, dict[Setting, ParameterControl]] = {}
        self._shown: dict[str, tuple[Setting, ParameterControl]] = {}
        self._rows: dict[str, QHBoxLayout] = {}
        self._labels: dict[str, QLabel] = {}
        self._is_wide = self._is_compact = self._is_narrow = False
        self._lines = set_spacing(QBoxLayout(QBoxLayout.Direction.TopToBottom), 1)
        fill(set_spacing(QVBoxLayout(self), 0), self._lines, 1)
        EventListener(self, self._leave_room_to_numbers, QEvent.Type.Resize)

    def offer_methods(self, methods: Iterable[tuple[str, object]]) -> None:
        """Offer the pinned parameters of these methods, (key, default parameters) each."""
        offered = [(key, list_settings(params)) for key, params in methods]
        for _, settings in offered:
            for name, (_, setting) in settings.items():
                if setting.pinned and name not in self._rows:
                    self._add_row(name, setting)
        for key, settings in offered:
            for name in self._rows:
                if name in settings and settings[name][1] not in self._controls[name]:
                    self._add_control(key, name, *settings[name])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self._rows)

    @property
    def needed_height_px(self) -> int:
        """Height of the controls, 0 where there are none."""
        return self._lines.sizeHint().height() if self._rows else 0

    def reserve_height(self, height_px: int) -> None:
        """Take this height, used or not: previews stay aligned."""
        height_px = max(height_px, self.needed_height_px)
        if height_px != self._height_px:
            self._height_px = height_px
            self.setFixedHeight(height_px)

    def set_wide(self, wide: bool) -> None:
        """Place all controls in one line if wide, numbers without labels and sliders where these
        find no room.
        """
        self._is_wide = wide
        self._leave_room_to_numbers()
        self._arrange()
        self.reserve_height(0)

    def set_compact(self, compact: bool) -> None:
        """Place all controls in one line, numbers without labels and sliders, unless wide."""
        if compact != self._is_compact:
            self._is_compact = compact
            self._arrange()
            self.reserve_height(0)

    def _leave_room_to_numbers(self) -> None:
        """Hide slider and label where there is little room."""
        is_narrow = self.width() < _SLIDERS_FROM_PX * (len(self._rows) if self._is_wide else 1)
        if is_narrow != self._is_narrow:
            self._is_narrow = is_narrow
            self._arrange()

    def _arrange(self) -> None:
        way = QBoxLayout.Direction
        one_line = self._is_wide or self._is_compact
        self._lines.setDirection(way.LeftToRight if one_line else way.TopToBottom)
        self._lines.setSpacing(
            (2 if self._is_narrow else 12) if self._is_wide else 2 if self._is_compact else 1
        )
        for index, name in enumerate(self._rows):
            n_letters = len(self._shown[name][0].pinned) + _NUMBER_LETTERS
            self._lines.setStretch(index, n_letters if one_line else 1)
            self._arrange_control(name)

    def _arrange_control(self, name: str) -> None:
        setting, control = self._shown[name]
        compact = self._is_narrow if self._is_wide else self._is_compact
        self._labels[name].setHidden(compact)
        name_inside = f"{setting.pinned.lower()} " if self._is_wide or not self._is_narrow else ""
        control.widget.setFixedHeight(_COMPACT_ROW_PX if compact else _ROW_PX)
        control.set_compact(compact, name_inside)
        for slider in control.sliders:
            slider.setHidden(compact or self._is_narrow)

    def show_params(self, key: str, params: object, reasons: Mapping[str, str]) -> None:
        """Show the values of a method without emitting a signal.

        `reasons`: name -> why it cannot act.
        """
        self._key = key
        self._params = params
        values = list_settings(params)
        for name in self._rows:
            if name in values:
                value, setting = values[name]
                self._show_control(name, setting)
                self._shown[name][1].show(value)
            self._shown[name][1].set_unavailable(reasons.get(name, ""))

    def show_unused(self, reason: str) -> None:
        """Strike out the parameters of a method that did not answer, with the reason.

        "" = it did.
        """
        for name, label in self._labels.items():
            for widget in (label, self._shown[name][1].widget):
                mark_unused(widget, reason)

    def get_control(self, name: str) -> QWidget:
        """The control of a parameter."""
        return self._shown[name][1].widget

    def _add_row(self, name: str, setting: Setting) -> None:
        row = self._rows[name] = set_spacing(QHBoxLayout(), 4)
        label = self._labels[name] = QLabel(setting.pinned)
        label.setFixedWidth(_LABEL_PX)
        resize_font(label)
        row.addWidget(label)
        self._lines.addLayout(row, 1)
        self._controls[name] = {}

    def _show_control(self, name: str, setting: Setting) -> None:
        """Show the control of this range, hide the others."""
        if self._shown[name][0] != setting:
            self._shown[name][1].widget.hide()
            self._shown[name] = setting, self._controls[name][setting]
            self._shown[name][1].widget.show()
            self._arrange_control(name)

    def _add_control(self, key: str, name: str, value: Value, setting: Setting) -> None:
        """Add the control of one range; the first one is shown."""
        control = make_control(value, setting, partial(self._emit_edited, name))
        control.set_narrow()
        for widget in (control.widget, *control.widget.findChildren(QWidget)):
            resize_font(widget)
        control.widget.setToolTip(describe_setting(setting, f"{key.partition('/')[0]}.{name}"))
        control.set_names(f"pinned_{name}", setting.label)
        for slider in control.sliders:
            slider.sliderPressed.connect(lambda: self.slider_held.emit(self._key))
            slider.sliderReleased.connect(lambda: self.slider_held.emit(""))
        self._rows[name].addWidget(control.widget, 1)
        self._controls[name][setting] = control
        if name in self._shown:
            control.widget.hide()
            return
        self._shown[name] = setting, control
        self._arrange_control(name)

    def _emit_edited(self, name: str, value: Value) -> None:
        if name in list_settings(self._params):
            params = replace_value(self._params, name, value)
            if params != self._params:
                self._params = params
                self.params_edited.emit(self._key, params)
