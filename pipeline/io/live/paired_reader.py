"""Two live sensors at once: both fingers of a gripper, or source and target on the same object.

They are one recording of two streams, whose frames are paired by time like those of any recording
(`core/values/pairing.py`): so the second sensor is the truth of a live translation to it.
"""

import time
from dataclasses import replace

from pipeline.core.values.frames import Stream, TactileFrame
from pipeline.core.values.pairing import NO_PARTNER, pair_frames
from pipeline.io.live.reader import MAX_BYTES, Listener, LiveReader, ReaderStatus
from pipeline.io.live.source import LiveSource

_WAIT_S = 0.1  # for the partner of a frame to come


class PairedReader(LiveReader):
    """Reads a source, and a partner beside it; the frames are those of the source."""

    def __init__(self, source: LiveSource, partner: LiveSource) -> None:
        super().__init__(source, max_bytes=MAX_BYTES // 2)
        self.partner = LiveReader(partner, max_bytes=MAX_BYTES // 2, beside=self)
        self._n_settled = self._n_unpaired = 0
        self._n_counted = -1  # frames whose partners were counted; -1 = not begun

    def start(self) -> None:
        """Begin to read both."""
        super().start()
        self.partner.start()

    def stop(self, timeout_s: float = 0.0) -> bool:
        """Ask both threads to end; whether they have ended, each within the timeout."""
        self.partner.stop()
        return super().stop(timeout_s) & self.partner.stop(timeout_s)

    def set_listener(self, listener: Listener | None) -> None:
        """Call `listener` with every frame of both; None removes it."""
        super().set_listener(listener)
        self.partner.set_listener(listener)

    @property
    def title(self) -> str:
        """Names of both for people."""
        return f"{self.source.title} and {self.partner.title}"

    @property
    def n_frames(self) -> int:
        """Number of frames whose partners have come, or do not come in time."""
        newest_s = self.partner.newest_s
        with self._lock:
            n = self._first_index + len(self._buffer)
            ends_s = time.monotonic() - self._start_s - _WAIT_S
            for frame, _ in reversed(self._buffer):
                if frame.time_s <= max(newest_s, ends_s):
                    break
                n -= 1
            self._n_settled = max(self._n_settled, n)
            return self._n_settled

    @property
    def has_reference(self) -> bool:
        """Whether both references have been captured."""
        return super().has_reference and self.partner.has_reference

    def capture_reference(self) -> str:
        """Set both references, as `LiveReader` does."""
        return super().capture_reference() or self.partner.capture_reference()

    def status(self) -> ReaderStatus:
        """State of both; what is wrong with the partner says so."""
        own = super().status()
        beside = self.partner.status()
        problem = f"partner: {beside.message}" if beside.message else ""
        if self.has_reference:
            self._count_unpaired()
        return replace(
            own,
            message=own.message or problem,
            n_unpaired=self._n_unpaired,
            partner=beside,
        )

    def _count_unpaired(self) -> None:
        one, other = self.make_streams()
        first = one.n_frames if self._n_counted < 0 else max(self._n_counted, self._first_index)
        found = pair_frames(one, other).partners[first:]
        self._n_unpaired += int((found == NO_PARTNER).sum())
        self._n_counted = one.n_frames

    def make_streams(self) -> tuple[Stream, ...]:
        """The frames of both so far."""
        return (*super().make_streams(), *self.partner.make_streams())

    def find_partner(self, index: int) -> TactileFrame | None:
        """The partner's frame of the time of a frame; None where it took none, or none is here."""
        one, other = self.make_streams()
        partners = pair_frames(one, other).partners.tolist()
        partner = partners[index] if index < len(partners) else NO_PARTNER
        return None if partner == NO_PARTNER else other.frame(partner)


def make_reader(source: LiveSource, partner: LiveSource | None = None) -> LiveReader:
    """The reader of one sensor, or of two."""
    return LiveReader(source) if partner is None else PairedReader(source, partner)
