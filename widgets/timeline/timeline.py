"""Timeline: the current frame, and playback."""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QSignalBlocker, Qt, QTimer, pyqtSignal
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QComboBox, QGridLayout, QLabel, QSlider, QSpinBox, QWidget

from widgets.style.styling import make_command_button, make_row, make_text, name_widget
from widgets.timeline.error_strip import ErrorScale, ErrorStrip

_TIMES = "\N{MULTIPLICATION SIGN}"
SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0)
FRAMES_PER_SECOND = 10.0  # at speed 1, when the recording has no timestamps
_LATE_MS = 10  # interval to check for an overdue frame again
_STEPS_SHOWN = 8
_ROUNDING = 1e-6  # of a frame
_MOST_DUE = 4.0  # frames: after a longer wait playback continues without catching up


class Timeline(QWidget):
    """Slider, frame number and playback; `frame_chosen` carries the requested frame.

    `unit` names what is stepped through; errors are shown for frames alone.
    """

    frame_chosen = pyqtSignal(int)
    play_toggled = pyqtSignal(bool)

    def __init__(self, *, unit: str = "frame") -> None:
        super().__init__()
        self._unit = unit
        self._n_frames = 0
        self._ready = True
        self.frame = 0  # the current frame
        # fraction of the next frame that playback has waited for, and until when
        self._due = self._ticked_s = 0.0
        self._clock = QTimer(self)
        self._clock.setTimerType(Qt.TimerType.PreciseTimer)
        self._clock.timeout.connect(self._tick)
        self.slider = name_widget(QSlider(Qt.Orientation.Horizontal), f"{unit}_slider", unit)
        self.number = name_widget(QSpinBox(), f"{unit}_number", f"{unit} number")
        self.number.setKeyboardTracking(False)
        self.errors = ErrorStrip()
        self.scale = ErrorScale()
        self._figure, self._worst = make_text(), make_text()
        self._of, self._time = QLabel(), QLabel()
        self._left_out = name_widget(
            QLabel(),
            "left_out",
            tip="computing a frame takes longer than its display time: frames in between are "
            "skipped",
        )
        # frames advanced in recent playback steps
        self._steps: deque[int] = deque(maxlen=_STEPS_SHOWN)
        self._time.setMinimumWidth(self.fontMetrics().horizontalAdvance("t = 0000.00 s"))
        self.speed = name_widget(
            QComboBox(),
            "",
            "playback speed",
            f"playback speed; 1{_TIMES} shows {FRAMES_PER_SECOND:g} frames per second at most",
        )
        for value in SPEEDS:
            self.speed.addItem(f"{value:g}{_TIMES}", value)
        self.speed.setCurrentIndex(SPEEDS.index(1.0))
        # first and last frame of the loop
        self._looping = False
        self.loop_range = (0, 0)
        self._buttons = make_row(1)
        self._lay_out()
        self.slider.valueChanged.connect(self._choose)
        self.number.valueChanged.connect(self._choose)
        self.errors.frame_chosen.connect(self._choose)
        self.show_frames(0)

    def _lay_out(self) -> None:
        layout = QGridLayout(self)
        layout.setContentsMargins(6, 2, 6, 2)
        layout.setVerticalSpacing(0)
        layout.setColumnStretch(1, 1)
        right = make_row(
            6,
            QLabel(self._unit),
            self.number,
            self._of,
            self._time,
            self._left_out,
            QLabel("speed"),
            self.speed,
        )
        layout.addLayout(self._buttons, 0, 0)
        layout.addLayout(right, 0, 2)
        if self._unit != "frame":
            layout.addWidget(self.slider, 0, 1)
            return
        layout.addLayout(make_row(12, (self._figure, 1), self.scale), 1, 0)
        layout.addWidget(self.errors, 0, 1, 2, 1)  # its frames are chosen by a click or drag
        layout.addWidget(self._worst, 1, 2)
        for label in (self._figure, self._worst):
            label.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)

    def add_command(self, action: QAction) -> None:
        """Add a button for a command at the left of the slider."""
        self._buttons.addWidget(make_command_button(action))

    @property
    def is_playing(self) -> bool:
        """Whether playback is running."""
        return self._clock.isActive()

    def show_frames(self, n_frames: int) -> None:
        """Offer frames 0 to `n_frames` - 1."""
        if n_frames != self._n_frames:
            keeps_loop = self.errors.loop_range is not None and n_frames > self._n_frames
            self._n_frames = n_frames
            self.set_loop_range(*(self.loop_range if keeps_loop else (0, n_frames - 1)))
        last = max(0, n_frames - 1)
        with QSignalBlocker(self.slider), QSignalBlocker(self.number):
            self.slider.setRange(0, last)
            self.number.setRange(0, last)
        self._of.setText(f"of {n_frames}")
        self.setEnabled(n_frames > 0)
        self.show_errors("", (), {})
        if n_frames <= 1:
            self.play(on=False)

    def show_frame(self, frame: int, time_s: float = math.nan) -> None:
        """Show the current frame without emitting a signal."""
        self.frame = frame
        with QSignalBlocker(self.slider), QSignalBlocker(self.number):
            self.slider.setValue(frame)
            self.number.setValue(frame)
        self.errors.show_frame(frame)
        self._time.setText(f"t = {time_s:.2f} s" if math.isfinite(time_s) else "")

    def show_errors(
        self,
        metric: str,
        values: Sequence[float],
        warnings: Mapping[int, Sequence[str]],
        *,
        is_quantity: bool = False,
    ) -> None:
        """Show the error of every frame under the slider (NaN = unknown), and the warnings of each.

        `metric` is its name and, after a comma, its unit. A quantity that is no error is a curve.
        """
        name, _, unit = metric.partition(", ")
        self.errors.show_values(values, unit, warnings, is_curve=is_quantity)
        worst = self.errors.worst_frame
        self.scale.show_max(self.errors.max_value)
        if worst < 0:
            self._figure.setText(f"{name}: not known" if values else "")
            self._worst.clear()
            return
        self._figure.setText(metric)
        which = "largest" if is_quantity else "worst"
        self._worst.setText(f"{which}: frame {worst}, {values[worst]:.3g} {unit}")

    def show_ready(self, *, ready: bool) -> None:
        """Set whether the current frame is on screen: playback waits for it."""
        self._ready = ready
        if ready and self._due >= 1.0 and self.is_playing:
            # overdue: advance soon, but not from within the call that shows this frame
            self._clock.start(0)

    def play(self, *, on: bool) -> None:
        """Start or stop playback."""
        on = on and self._n_frames > 1
        if on == self._clock.isActive():
            return
        if on:
            if self.frame >= self._n_frames - 1:
                self.step_to(0)
            self._due = 0.0
            self._ticked_s = time.monotonic()
            self._clock.start(self._until_due_ms())
        else:
            self._clock.stop()
        self._steps.clear()
        self._left_out.clear()
        self.play_toggled.emit(on)

    def set_looping(self, looping: bool) -> None:
        """Set whether playback starts again after the last frame."""
        self._looping = looping

    def set_loop_range(self, first: int, last: int) -> None:
        """Set the loop range, in either order."""
        most = max(0, self._n_frames - 1)
        first, last = sorted((min(max(first, 0), most), min(max(last, 0), most)))
        self.loop_range = (first, last)
        self.errors.show_loop_range(None if self.loop_range == (0, most) else self.loop_range)

    def step_to(self, frame: int) -> None:
        """Go to a frame, clipped to the ends."""
        self._choose(min(max(frame, 0), max(0, self._n_frames - 1)))

    def _choose(self, frame: int) -> None:
        if frame == self.frame or self._n_frames == 0:
            return
        self.show_frame(frame)
        self.frame_chosen.emit(frame)

    def _tick(self) -> None:
        # ticks are late on a busy machine: the clock tells what is due, not the number of ticks
        now_s = time.monotonic()
        waited_s = now_s - self._ticked_s
        self._ticked_s = now_s
        self._due = min(self._due + waited_s * self._rate, _MOST_DUE)
        by = int(self._due + _ROUNDING)
        if by and self._ready:
            self._due -= by
            self._steps.append(by)
            shown, passed = len(self._steps), sum(self._steps)
            self._left_out.setText(f"{shown} of {passed} shown" if passed > shown else "")
            self._go_on(self.frame + by)
        if self.is_playing:
            self._clock.start(self._until_due_ms())

    @property
    def _rate(self) -> float:
        """Return the frames per second."""
        return FRAMES_PER_SECOND * float(self.speed.currentData())

    def _until_due_ms(self) -> int:
        """Return the time until the next frame is due, in ms.

        Polling would be late by half of its interval.
        """
        return (
            max(1, math.ceil(1e3 * (1.0 - self._due) / self._rate)) if self._due < 1.0 else _LATE_MS
        )

    def _go_on(self, following: int) -> None:
        if self._looping:
            first, last = self.loop_range
            self.step_to(following if first <= self.frame and following <= last else first)
            return
        self.step_to(following)
        if following >= self._n_frames:
            self.play(on=False)
