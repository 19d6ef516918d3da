"""Filter of the frames table: frames for which every term holds."""

import math
import re
from collections.abc import Callable

from PyQt6.QtCore import QAbstractTableModel, QModelIndex, QSortFilterProxyModel

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


class RowFilter(QSortFilterProxyModel):
    """Sorts by the table's sort role; lists the rows of the source for which all terms of a filter hold."""

    def __init__(self, model: QAbstractTableModel, matches: Callable[[int, str], bool]) -> None:
        """`matches(row, term)` returns whether a term holds."""
        super().__init__(model)
        self._words, self._matches = tuple[str, ...](), matches
        self.setSourceModel(model)
        self.setSortRole(SORT_ROLE)

    def set_filter(self, words: str) -> None:
        """List the rows for which all terms hold; all rows for no term."""
        wanted = tuple(words.lower().split())
        if wanted != self._words:
            self._words = wanted
            self.invalidateFilter()

    def filterAcceptsRow(self, source_row: int, source_parent: QModelIndex) -> bool:  # noqa: N802
        """Return whether a row is listed."""
        return not source_parent.isValid() and all(self._matches(source_row, word) for word in self._words)


def matches_limit(word: str, value: float) -> bool | None:
    """Return whether a value is beyond the limit that a term is, never if it is unknown; None for another term."""
    limit = _LIMIT.match(word)
    if limit is None:
        return None
    bound = float(limit.group(2))
    return value > bound if limit.group(1) == ">" else -math.inf < value < bound


def matches_term(model: FramesModel, frame: int, word: str) -> bool:
    """Return whether a filter term holds for a frame; unknown values never match."""
    summary = model.get_summary(frame)
    is_within = matches_limit(word, float(str(model.data(model.index(frame, METRIC), SORT_ROLE))))
    if is_within is not None:
        return is_within
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
