"""Start, progress and cancellation of something that runs in the background."""

import math

from PyQt6.QtWidgets import QProgressBar, QPushButton, QWidget

from widgets.style.styling import make_row

_BAR_PX = 140


class RunBar(QWidget):
    """Progress bar and *Cancel*, visible while something runs.

    With `keeps_room` nothing moves as they come and go.
    """

    def __init__(self, name: str, *, keeps_room: bool = False) -> None:
        super().__init__()
        self.bar = QProgressBar()
        self.cancel_button = QPushButton("Cancel")
        self.cancel_button.setObjectName(f"{name}_cancel")
        self.bar.setRange(0, 1000)
        self.bar.setTextVisible(False)
        self.bar.setFixedWidth(_BAR_PX)
        self.row = make_row(6, on=self)
        for widget in (self.bar, self.cancel_button):
            self.row.addWidget(widget)
            policy = widget.sizePolicy()
            policy.setRetainSizeWhenHidden(keeps_room)
            widget.setSizePolicy(policy)
            widget.hide()

    def show_progress(self, fraction: float | None) -> None:
        """Show how much is done, 0 to 1; None shows that nothing runs."""
        for widget in (self.bar, self.cancel_button):
            widget.setVisible(fraction is not None)
        if fraction is not None and math.isfinite(fraction):
            self.bar.setValue(round(1000 * fraction))


class StartBar(RunBar):
    """Start button while nothing runs, else progress bar and *Cancel*."""

    def __init__(self, name: str, start: str) -> None:
        super().__init__(name)
        self.start_button = QPushButton(start)
        self.start_button.setObjectName(f"{name}_start")
        self.row.insertWidget(0, self.start_button)

    def show_progress(self, fraction: float | None) -> None:
        """Show how much is done, 0 to 1; None offers to start."""
        super().show_progress(fraction)
        self.start_button.setVisible(fraction is None)
