"""Filter of the frames table: frames for which every term holds."""

from __future__ import annotations

import math
import re

from PyQt6.QtCore import QModelIndex, QSortFilterProxyModel

from widgets.frames_model import METRIC, SORT_ROLE, FramesModel

_LIMIT = re.compile(r"([<>])=?(-?\d+(?:\.\d*)?|-?\.\d+)$")


def get_limits(words: str) -> tuple[float, float]:
    """Return the range that the limits among the terms of a filter leave, infinite where there is none."""
    limits = [match for match in map(_LIMIT.match, words.split()) if match is not None]
    return (
        max((float(m.group(2)) for m in limits if m.group(1) == ">"), default=-math.inf),
        min((float(m.group(2)) for m in limits if m.group(1) == "<"), default=math.inf),
    )


def replace_limits(words: str, low: float, high: float) -> str:
    """Return the filter with these limits in place of its own, none where they are infinite."""
    others = [word for word in words.split() if _LIMIT.match(word) is None]
    limits = [f"{sign}{_format_limit(value)}" for sign, value in ((">", low), ("<", high)) if math.isfinite(value)]
    return " ".join((*others, *limits))


def _format_limit(value: float) -> str:
    """Return a number to three significant digits, without an exponent."""
    digits = 2 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{min(max(digits, 0), 9)}f}"


class FramesFilter(QSortFilterProxyModel):
    """Sorts by the table's sort role; lists what `set_filter` matches."""

    def __init__(self, parent: object = None) -> None:
        super().__init__(parent)  # type: ignore[arg-type]
        self._words: tuple[str, ...] = ()
        self.setSortRole(SORT_ROLE)

    def set_filter(self, words: str) -> None:
        """List the frames for which all terms hold; all frames for no term."""
        wanted = tuple(words.lower().split())
        if wanted != self._words:
            self._words = wanted
            self.invalidateFilter()

    def filterAcceptsRow(self, source_row: int, source_parent: QModelIndex) -> bool:  # noqa: N802
        """Return whether a frame is listed."""
        model = self.sourceModel()
        assert isinstance(model, FramesModel)
        return not source_parent.isValid() and all(matches_term(model, source_row, word) for word in self._words)


def matches_term(model: FramesModel, frame: int, word: str) -> bool:
    """Return whether a filter term holds for a frame; unknown values never match."""
    summary, limit = model.get_summary(frame), _LIMIT.match(word)
    if limit is not None:
        value = float(str(model.data(model.index(frame, METRIC), SORT_ROLE)))
        bound = float(limit.group(2))
        return value > bound if limit.group(1) == ">" else -float("inf") < value < bound
    own = {
        "contact": summary is not None and summary.contact_area_mm2 > 0,
        "no-contact": summary is not None and not summary.problem and summary.contact_area_mm2 <= 0,
        "warned": bool(model.get_specific_warnings(frame)),
        "noted": bool(model.get_note(frame)),
        "failed": summary is not None and bool(summary.problem),
    }
    if word in own:
        return own[word]
    texts = (model.get_note(frame), *(() if summary is None else (*summary.warnings, summary.problem)))
    return any(word in text.lower() for text in texts)
