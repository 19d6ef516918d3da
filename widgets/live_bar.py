"""Live strip over the stages: rate, problems, set reference, record, back to the newest frame."""

from PyQt6.QtWidgets import QFrame, QHBoxLayout, QLabel, QSizePolicy

from widgets.styling import fill, make_bold, make_button, set_spacing


class LiveBar(QFrame):
    """Hidden while no sensor is live."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("live_bar")
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self._title, self._rates, self._wrong = QLabel(), QLabel(), QLabel()
        make_bold(self._title)
        make_bold(self._wrong)
        self._rates.setToolTip("frames per second over the last two seconds; lost: counted by the sensor")
        self._wrong.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        zero_tip = "Use the last frames as the reference image; nothing may touch the sensor"
        self.follow = make_button("Follow", "live_follow", "Follow the newest frame")
        self.zero = make_button("Set zero", "live_set", zero_tip)
        self.record = make_button(
            "Record…", "live_record", "Record every frame to a file that can be opened at any time"
        )
        self.stop = make_button("Stop", "live_stop", "Disconnect the sensor; the frames stay on screen")
        self.follow.setCheckable(True)
        self.record.setCheckable(True)
        row = set_spacing(QHBoxLayout(self), 6, (8, 3, 8, 3))
        fill(row, self._title, self._rates, (self._wrong, 1), self.follow, self.zero, self.record, self.stop)
        self.hide()

    @property
    def text(self) -> str:
        """All visible text."""
        return " ".join(label.text() for label in (self._title, self._rates, self._wrong))

    def show_source(self, title: str) -> None:
        """Show the name of the live sensor."""
        self._title.setText(title)
        self.show_rates("connecting")
        self.show()

    def show_rates(self, rates: str, wrong: str = "") -> None:
        """Show the frame rate and what is wrong with it."""
        self._rates.setText(rates)
        self._wrong.setText(wrong)
        self._wrong.setToolTip(wrong)

    def show_state(self, *, following: bool, recording: bool) -> None:
        """Show whether the newest frame is followed, and whether frames are recorded."""
        self.follow.setChecked(following)
        self.record.setChecked(recording)
        self.record.setText("Stop recording" if recording else "Record…")
