"""A slider over the kept iterations of the registration."""

from __future__ import annotations

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QSlider, QWidget

from pipeline.values.results import PoseStep
from widgets.looks import smaller, spaced


class StepsSlider(QWidget):
    """Which iteration is shown, and how good it was; `step_chosen` carries the `PoseStep`."""

    step_chosen = pyqtSignal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._steps: tuple[PoseStep, ...] = ()
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setObjectName("pose_steps")
        self.slider.setAccessibleName("iteration of the registration")
        self.slider.setToolTip("Iteration of the registration")
        self._text = QLabel("no registration")
        self.slider.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        smaller(self._text)
        layout = spaced(QHBoxLayout(self), 4)
        layout.addWidget(self.slider, 1)
        layout.addWidget(self._text, 0)
        self.slider.valueChanged.connect(self._chosen)
        self.show_steps(())

    def show_steps(self, steps: tuple[PoseStep, ...]) -> None:
        """Offer these iterations and stand on the last."""
        self._steps = steps
        with QSignalBlocker(self.slider):
            self.slider.setRange(0, max(0, len(steps) - 1))
            self.slider.setValue(len(steps) - 1)
        self.slider.setEnabled(len(steps) > 1)
        self._tell(len(steps) - 1)

    def _chosen(self, at: int) -> None:
        if 0 <= at < len(self._steps):
            self._tell(at)
            self.step_chosen.emit(self._steps[at])

    def _tell(self, at: int) -> None:
        if not 0 <= at < len(self._steps):
            self._text.setText("no registration")
            return
        step = self._steps[at]
        self._text.setText(f"{at + 1}/{len(self._steps)}: {step.rmse_mm:.2f} mm")
        matched = f"{100 * step.fitness:.0f} % of the points matched"
        self._text.setToolTip(f"iteration {at + 1} of {len(self._steps)}: rms {step.rmse_mm:.3f} mm, {matched}")
