"""Start, progress and cancellation of something that runs in the background."""

from __future__ import annotations

import math

from PyQt6.QtWidgets import QHBoxLayout, QProgressBar, QPushButton, QWidget

from widgets.styling import set_spacing

_BAR_PX = 140


class RunBar(QWidget):
    """Start button, if it has a text, or progress bar and *Cancel* while something runs.

    With `keeps_room` nothing moves as bar and *Cancel* come and go.
    """

    def __init__(self, name: str, start: str = "", *, keeps_room: bool = False) -> None:
        super().__init__()
        self.start_button, self.bar, self.cancel_button = QPushButton(start), QProgressBar(), QPushButton("Cancel")
        self.start_button.setObjectName(f"{name}_start")
        self.cancel_button.setObjectName(f"{name}_cancel")
        self.bar.setRange(0, 1000)
        self.bar.setTextVisible(False)
        self.bar.setFixedWidth(_BAR_PX)
        row = set_spacing(QHBoxLayout(self), 6)
        for widget in (self.start_button, self.bar, self.cancel_button):
            row.addWidget(widget)
            policy = widget.sizePolicy()
            policy.setRetainSizeWhenHidden(keeps_room and widget is not self.start_button)
            widget.setSizePolicy(policy)
        self.show_progress(None)

    def show_progress(self, fraction: float | None) -> None:
        """Show how much is done, 0 to 1; None offers to start."""
        self.start_button.setHidden(fraction is not None or not self.start_button.text())
        for widget in (self.bar, self.cancel_button):
            widget.setVisible(fraction is not None)
        if fraction is not None and math.isfinite(fraction):
            self.bar.setValue(round(1000 * fraction))
