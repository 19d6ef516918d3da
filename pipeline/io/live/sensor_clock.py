"""When frames of a live sensor were taken, by this machine's clock, and which did not arrive."""

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median

from pipeline.io.live.source import LiveFrame

_JUMP_S = 2.0  # by which stamps and arrivals may differ from one frame to the next
_DRIFT = 1e-4  # of a sensor's clock over ours, at most
_USUAL_STEPS = 15  # between stamps, whose median is the sensor's interval


@dataclass(slots=True, kw_only=True)
class SensorClock:
    """What numbers and stamps of a sensor tell, frame by frame.

    A sensor's clock may be off by any time, and a network delays frames by different times: a frame
    was taken at its stamp, with the least delay that frames have had.
    """

    n_lost: int = 0  # by the sensor's numbers, or else by gaps between its stamps
    n_doubled: int = 0  # frames with the stamp of the one before
    n_jumps: int = 0  # steps of the sensor's clock that its rate does not explain
    _last: LiveFrame | None = None
    _delay_s: float = math.nan  # with the difference of the two clocks
    _steps_s: deque[float] = field(default_factory=lambda: deque[float](maxlen=_USUAL_STEPS))

    def restart(self) -> None:
        """Begin again with a sensor that was opened again."""
        self._last = None
        self._steps_s.clear()

    def add(self, frame: LiveFrame) -> float:
        """Count what went wrong before a frame, and return the monotonic time when it was taken.

        Without a stamp that is when it arrived.
        """
        last = self._last
        self._last = frame
        delay_s = frame.time_s - frame.stamp_s
        step_s = math.nan if last is None else frame.stamp_s - last.stamp_s
        is_jump = last is not None and abs(step_s - (frame.time_s - last.time_s)) > _JUMP_S
        self.n_doubled += step_s == 0
        self.n_jumps += is_jump
        is_steady = step_s > 0 and not is_jump
        if last is not None and frame.sequence_number >= 0:
            if last.sequence_number >= 0:
                self.n_lost += max(0, frame.sequence_number - 1 - last.sequence_number)
        elif is_steady:
            if len(self._steps_s) == _USUAL_STEPS:
                self.n_lost += max(0, round(step_s / median(self._steps_s)) - 1)
            self._steps_s.append(step_s)
        self._delay_s = min(delay_s, self._delay_s + _DRIFT * step_s) if is_steady else delay_s
        return frame.time_s if math.isnan(delay_s) else frame.stamp_s + self._delay_s
