"""A 3D view with a legend or a step slider, and the name of its frame."""

from PyQt6.QtCore import QEvent, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QTextDocumentFragment
from PyQt6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QMenu,
    QSizePolicy,
    QSlider,
    QToolButton,
    QWidget,
)

from pipeline.core.values.results import PoseStep, TouchStep
from widgets.style.base import EventListener, FixedSizeLabel
from widgets.style.styling import fill, make_command_button, make_icon_button, set_spacing
from widgets.views.view_3d import View3D

AnyStep = PoseStep | TouchStep
_BELOW = Qt.AlignmentFlag.AlignBottom


class View3DPanel(QWidget):
    """`view` with `legend`, or `under` in its place, and `caption` along its lower edge."""

    def __init__(self, under: QWidget | None = None) -> None:
        super().__init__()
        self.view = View3D()
        self.legend = FixedSizeLabel()
        self.caption = FittingLabel()
        for label in (self.legend, self.caption):
            label.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        line = set_spacing(QHBoxLayout(), 8, (4, 0, 4, 2))
        self._grid = set_spacing(QGridLayout(self), 0)
        self._grid.addWidget(self.view, 0, 0)
        self._grid.addLayout(fill(line, (under or self.legend, 1), (self.caption, 1)), 0, 0, _BELOW)


class ScenePanel(View3DPanel):
    """The view of both sensors, with buttons in its upper left corner and a menu."""

    def __init__(self) -> None:
        self.sensors = FittingLabel(Qt.AlignmentFlag.AlignLeft)
        super().__init__(self.sensors)
        self.view.keys = frozenset({Qt.Key.Key_Space})
        self.view.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.view.setAccessibleName("both sensors and the object")
        self._tools = set_spacing(QHBoxLayout(), 0)
        corner = Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft
        self._grid.addLayout(self._tools, 0, 0, corner)

    def offer(self, motion: QAction, menu: QMenu) -> None:
        """Offer the motion and the menu of the scene."""
        views = make_icon_button("sliders", "scene_menu", "Views and tools of the scene")
        views.setMenu(menu)
        views.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        fill(self._tools, make_command_button(motion), views)
        self.view.menu_requested.connect(menu.popup)


class FittingLabel(QLabel):
    """One line of rich text: the longest of several versions that fits."""

    def __init__(self, side: Qt.AlignmentFlag = Qt.AlignmentFlag.AlignRight) -> None:
        super().__init__()
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAlignment(side | Qt.AlignmentFlag.AlignVCenter)
        self._tellings: tuple[str, ...] = ()
        self._widths: list[int] = []
        EventListener(self, self._fit, QEvent.Type.Resize)

    def set_texts(self, *tellings: str) -> None:
        """Set the versions, the longest first; that one is the tooltip, without markup."""
        if tellings != self._tellings:
            self._tellings = tellings
            self._widths = [self._width(telling) for telling in tellings]
            self.setToolTip(QTextDocumentFragment.fromHtml(tellings[0]).toPlainText())
            self._fit()

    def _width(self, telling: str) -> int:
        self.setText(telling)
        return self.sizeHint().width()

    def _fit(self) -> None:
        fitting = [
            t
            for t, width in zip(self._tellings, self._widths, strict=True)
            if width <= self.width()
        ]
        if self._tellings:
            self.setText((fitting or self._tellings[-1:])[0])


class StepsSlider(QWidget):
    """Selects a kept step and shows its quality.

    `step_chosen` carries stage, step and its number.
    """

    step_chosen = pyqtSignal(str, object, int)
    keep_steps_requested = pyqtSignal(str)

    def __init__(self, stage: str = "pose") -> None:
        super().__init__()
        self._slot = stage
        self._steps: tuple[AnyStep, ...] = ()
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setObjectName(f"{stage}_steps")
        self.slider.setAccessibleName(f"step of the {stage}")
        self.slider.setToolTip(f"Steps of the {stage}")
        self._text = QLabel()
        self.keep_button = QToolButton()
        self.keep_button.setText("Step through")
        self.keep_button.setObjectName(f"{stage}_keep")
        self.keep_button.setToolTip(
            "Keep the steps and show them one by one; the result stays the same"
        )
        self.keep_button.setAutoRaise(True)
        self.keep_button.clicked.connect(lambda: self.keep_steps_requested.emit(self._slot))
        self._keeps = False
        self.slider.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        for widget in (self._text, self.keep_button):
            # the height of the legends next to it
            widget.setFixedHeight(widget.fontMetrics().height() + 1)
        fill(set_spacing(QHBoxLayout(self), 4), (self.slider, 1), self._text, self.keep_button)
        self.slider.valueChanged.connect(self._choose_step)
        self.show_steps(())

    def show_steps(self, steps: tuple[AnyStep, ...]) -> None:
        """Offer these steps and select the last."""
        self._steps = steps
        with QSignalBlocker(self.slider):
            self.slider.setRange(0, max(0, len(steps) - 1))
            self.slider.setValue(len(steps) - 1)
        self.slider.setEnabled(len(steps) > 1)
        self._tell(len(steps) - 1)
        self.set_can_keep_steps(can_keep=self._keeps)

    def set_can_keep_steps(self, *, can_keep: bool) -> None:
        """Set whether the method can keep steps; a button requests them where none are kept."""
        self._keeps = can_keep
        asks = can_keep and not self._steps
        self.keep_button.setVisible(asks)
        self._text.setVisible(not asks)

    def _choose_step(self, at: int) -> None:
        if 0 <= at < len(self._steps):
            self._tell(at)
            self.step_chosen.emit(self._slot, self._steps[at], at)

    def _tell(self, at: int) -> None:
        if not 0 <= at < len(self._steps):
            self._text.setText("no steps kept")
            self._text.setToolTip("enable them in the method's parameters")
            return
        step = self._steps[at]
        place = f"{at + 1}/{len(self._steps)}"
        if isinstance(step, TouchStep):
            self._text.setText(f"{place}: {step.label}")
            self._text.setToolTip(f"state {at + 1} of {len(self._steps)}: {step.label}")
            return
        self._text.setText(f"{place}: {step.rmse_mm:.2f} mm")
        matched = f"{100 * step.fitness:.0f} % of the points matched"
        self._text.setToolTip(
            f"iteration {at + 1} of {len(self._steps)}: rms {step.rmse_mm:.3f} mm, {matched}"
        )
