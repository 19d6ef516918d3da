"""A slider over the kept states of a slot: iterations of a registration, steps of a sampler."""

from __future__ import annotations

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QSlider, QToolButton, QWidget

from pipeline.values.results import PoseStep, TouchStep
from widgets.looks import smaller, spaced

Step = PoseStep | TouchStep


class StepsSlider(QWidget):
    """Which state of a slot is shown, and how good it was; `step_chosen` carries the slot, the state and its number."""

    step_chosen = pyqtSignal(str, object, int)
    keep_wanted = pyqtSignal(str)

    def __init__(self, slot: str = "pose", parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._slot = slot
        self._steps: tuple[Step, ...] = ()
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setObjectName(f"{slot}_steps")
        self.slider.setAccessibleName(f"state of the {slot}")
        self.slider.setToolTip(f"States on the way to the {slot}")
        self._text, self.keep = QLabel(), QToolButton()
        self.keep.setText("Step through")
        self.keep.setObjectName(f"{slot}_keep")
        self.keep.setToolTip("Keep the states on the way, which changes no answer, and look at them one by one")
        self.keep.setAutoRaise(True)
        self.keep.clicked.connect(lambda: self.keep_wanted.emit(self._slot))
        self._keeps = False
        self.slider.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        for widget in (self._text, self.keep):
            smaller(widget)
            widget.setFixedHeight(widget.fontMetrics().height() + 1)  # as high as the legends beside it
        layout = spaced(QHBoxLayout(self), 4)
        layout.addWidget(self.slider, 1)
        layout.addWidget(self._text, 0)
        layout.addWidget(self.keep, 0)
        self.slider.valueChanged.connect(self._chosen)
        self.show_steps(())

    def show_steps(self, steps: tuple[Step, ...]) -> None:
        """Offer these states and stand on the last."""
        self._steps = steps
        with QSignalBlocker(self.slider):
            self.slider.setRange(0, max(0, len(steps) - 1))
            self.slider.setValue(len(steps) - 1)
        self.slider.setEnabled(len(steps) > 1)
        self._tell(len(steps) - 1)
        self.offer(keeps=self._keeps)

    def offer(self, *, keeps: bool) -> None:
        """Whether the method can keep states: where none are kept yet, a button asks for them."""
        self._keeps = keeps
        asks = keeps and not self._steps
        self.keep.setVisible(asks)
        self._text.setVisible(not asks)

    def _chosen(self, at: int) -> None:
        if 0 <= at < len(self._steps):
            self._tell(at)
            self.step_chosen.emit(self._slot, self._steps[at], at)

    def _tell(self, at: int) -> None:
        if not 0 <= at < len(self._steps):
            self._text.setText("no states kept")
            self._text.setToolTip("a method keeps them where its parameters say so")
            return
        step, place = self._steps[at], f"{at + 1}/{len(self._steps)}"
        if isinstance(step, TouchStep):
            self._text.setText(f"{place}: noise {step.sigma:.2g}")
            self._text.setToolTip(f"state {at + 1} of {len(self._steps)}, seen through noise of {step.sigma:.3g} units")
            return
        self._text.setText(f"{place}: {step.rmse_mm:.2f} mm")
        matched = f"{100 * step.fitness:.0f} % of the points matched"
        self._text.setToolTip(f"iteration {at + 1} of {len(self._steps)}: rms {step.rmse_mm:.3f} mm, {matched}")
