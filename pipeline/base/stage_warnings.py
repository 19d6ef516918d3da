"""The two levels of what a method says of its answer: a plain note, and one that speaks against the answer."""

from __future__ import annotations

from collections.abc import Iterable


class StageWarning(str):
    """A note for which the answer beside it may be wrong: shown, counted and reported apart from plain ones.

    It is the sentence itself, so that whatever takes notes takes doubts.
    """

    __slots__ = ()


AT_BORDER = StageWarning("the contact reaches the image border: what lies beyond is not seen")


def select_warnings(notes: Iterable[str]) -> tuple[StageWarning, ...]:
    """Those of the notes that are doubts, in their order."""
    return tuple(note for note in notes if isinstance(note, StageWarning))
