"""A strip over the stages while a sensor is watched: what arrives, what is wrong, zero, recording, back to now."""

from __future__ import annotations

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QSizePolicy, QWidget

from widgets.styling import make_bold


class LiveBar(QFrame):
    """Hidden while nothing is watched."""

    zero_requested = pyqtSignal()
    record_toggled = pyqtSignal(bool)
    follow_toggled = pyqtSignal(bool)
    stop_requested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("live_bar")
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self._title, self._rates, self._wrong = QLabel(), QLabel(), QLabel()
        make_bold(self._title)
        make_bold(self._wrong)
        self._rates.setToolTip("readings a second that arrive, over the last two seconds; lost: counted by the sensor")
        self._wrong.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.follow, self.zero = QPushButton("Follow"), QPushButton("Set zero")
        self.record, self.stop = QPushButton("Record…"), QPushButton("Stop")
        for button, tip in (
            (self.follow, "Show the newest reading; off while you look back"),
            (self.zero, "Take the last readings as the untouched sensor: nothing may touch it"),
            (self.record, "Write every reading to a file that can be opened at any moment"),
            (self.stop, "Let go of the sensor; what is held stays on screen"),
        ):
            button.setToolTip(tip)
            button.setObjectName(f"live_{button.text().split(maxsplit=1)[0].strip('…').lower()}")
        self.follow.setCheckable(True)
        self.record.setCheckable(True)
        row = QHBoxLayout(self)
        row.setContentsMargins(8, 3, 8, 3)
        row.addWidget(self._title)
        row.addWidget(self._rates)
        row.addWidget(self._wrong, 1)
        for button in (self.follow, self.zero, self.record, self.stop):
            row.addWidget(button)
        self.follow.clicked.connect(self.follow_toggled)
        self.zero.clicked.connect(self.zero_requested)
        self.record.clicked.connect(self.record_toggled)
        self.stop.clicked.connect(self.stop_requested)
        self.hide()

    @property
    def text(self) -> str:
        """All that it says."""
        return " ".join(label.text() for label in (self._title, self._rates, self._wrong))

    def show_source(self, title: str) -> None:
        """Which sensor is watched."""
        self._title.setText(title)
        self.show_rates("looking for it")
        self.show()

    def show_rates(self, rates: str, wrong: str = "") -> None:
        """What arrives, and what is wrong with it."""
        self._rates.setText(rates)
        self._wrong.setText(wrong)
        self._wrong.setToolTip(wrong)

    def show_state(self, *, following: bool, recording: bool) -> None:
        """Whether the newest reading is shown, and whether all are written."""
        self.follow.setChecked(following)
        self.record.setChecked(recording)
        self.record.setText("Stop recording" if recording else "Record…")
