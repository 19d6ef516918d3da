"""A tab of the comparison page: a row of controls, a message with progress, and the results."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtWidgets import QHBoxLayout, QLabel, QLayout, QSizePolicy, QVBoxLayout, QWidget

from widgets.run_bar import RunBar
from widgets.styling import set_spacing


class ComparisonTab(QWidget):
    """Controls above a message above the widget with the results."""

    def __init__(self, controls: Sequence[QWidget] | QLayout, results: QWidget, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.message, self.run_bar = QLabel(), RunBar("compare", keeps_room=True)
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
        status.addWidget(self.run_bar)
        self.body = set_spacing(QHBoxLayout(), 6)
        self.body.addWidget(results, 1)
        self.stack = set_spacing(QVBoxLayout(self), 4, (4, 4, 4, 2))
        self.stack.addLayout(self.head)
        self.stack.addLayout(status)
        self.stack.addLayout(self.body, 3)
