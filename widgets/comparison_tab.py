"""A tab of the comparison page: a row of controls, a message with progress, and the results."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QLayout, QProgressBar, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from widgets.styling import set_spacing


class ComparisonTab(QWidget):
    """Controls above a message above the widget with the results."""

    cancel_requested = pyqtSignal()

    def __init__(self, controls: Sequence[QWidget] | QLayout, results: QWidget, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.message, self._bar, self._cancel = QLabel(), QProgressBar(), QPushButton("Cancel")
        self._bar.setRange(0, 1000)
        self._bar.setTextVisible(False)
        self._bar.setFixedWidth(140)
        self._cancel.setObjectName("compare_cancel")
        self._cancel.clicked.connect(self.cancel_requested)
        self.message.setWordWrap(True)
        self.message.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        self.head = set_spacing(QHBoxLayout(), 6)
        if isinstance(controls, QLayout):
            self.head.addLayout(controls, 1)
        else:
            for widget in controls:
                self.head.addWidget(widget)
            self.head.addStretch(1)
        status = set_spacing(QHBoxLayout(), 6)
        status.addWidget(self.message, 1)
        for widget in (self._bar, self._cancel):
            policy = widget.sizePolicy()
            policy.setRetainSizeWhenHidden(True)
            widget.setSizePolicy(policy)
            status.addWidget(widget)
        self.body = set_spacing(QHBoxLayout(), 6)
        self.body.addWidget(results, 1)
        self.stack = set_spacing(QVBoxLayout(self), 4, (4, 4, 4, 2))
        self.stack.addLayout(self.head)
        self.stack.addLayout(status)
        self.stack.addLayout(self.body, 3)
        self.show_progress(None)

    def show_progress(self, fraction: float | None) -> None:
        """Show the fraction done, or hide the bar for None."""
        for widget in (self._bar, self._cancel):
            widget.setVisible(fraction is not None)
        if fraction is not None:
            self._bar.setValue(round(1000 * fraction))
