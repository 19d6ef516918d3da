"""Notes on a stage's result: plain ones, and warnings."""

from collections.abc import Iterable


class StageWarning(str):
    """A note that the result may be wrong; shown, counted and reported apart from plain notes.

    It is a string, so that it goes wherever notes go.
    """


class AlignmentWarning(StageWarning):
    """A warning that the touch misses the target: another alignment mends it."""


class CalibrationWarning(StageWarning):
    """A warning that sizes and depths are unsure: a calibration of the source sensor mends it."""


class UnseenObjectWarning(StageWarning):
    """A warning that the target touches more of the object than the source measured: the touch may be wrong by mm."""


class OutsideViewWarning(UnseenObjectWarning):
    """A warning that a method leaves out what lies outside the source's view: one that generates it is better."""


class ChangeNote(str):
    """A note of how far a network's result is from physics; the window shows it as a badge."""


AT_BORDER = StageWarning("the contact reaches the image border: the part beyond is missing")


def select_warnings(notes: Iterable[str]) -> tuple[StageWarning, ...]:
    """Return the warnings among the notes, in order."""
    return tuple(note for note in notes if isinstance(note, StageWarning))
