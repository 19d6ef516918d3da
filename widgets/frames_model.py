"""Table model of the frames: what is known of each, sortable by any metric."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from PyQt6.QtCore import QAbstractTableModel, QModelIndex, Qt, pyqtSignal
from PyQt6.QtWidgets import QWidget

from widgets.icons import make_state_icon

SORT_ROLE = Qt.ItemDataRole.UserRole  # a number, so that 10 comes after 9; unknown values come last
FRAME, DEPTH, CONTACT, METRIC, NOTE = range(5)
_TITLES = ("frame", "depth\nmm", "area\nmm²")
_TIPS = (
    "frame number",
    "largest indentation of the source sensor, mm",
    "contact area on the source sensor, mm²",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSummary:
    """Summary of one frame."""

    max_indentation_mm: float = 0.0
    contact_area_mm2: float = 0.0
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])  # "stage.metric" -> value
    problem: str = ""  # why the frame has no result
    warnings: tuple[str, ...] = ()  # "stage: sentence"

    def get_value(self, column: int, figure: str) -> float:
        """Return the number of a cell; NaN if unknown."""
        if self.problem or (column != CONTACT and self.contact_area_mm2 <= 0):
            return math.nan
        return {DEPTH: self.max_indentation_mm, CONTACT: self.contact_area_mm2}.get(
            column, self.metrics.get(figure, math.nan)
        )


class FramesModel(QAbstractTableModel):
    """Frame numbers, summaries and notes; a frame that nobody looked at costs nothing.

    Emits `noted(frame, text)` when a note is written.
    """

    note_edited = pyqtSignal(int, str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._n_frames, self._figure, self._title = 0, "", "error"
        self._known: dict[int, FrameSummary] = {}
        self._notes: Mapping[int, str] = {}
        self._common: frozenset[str] | None = None  # None = not computed yet

    @property
    def metrics(self) -> tuple[str, ...]:
        """All metrics of the known frames, in order of first appearance."""
        return tuple(dict.fromkeys(name for known in self._known.values() for name in known.metrics))

    def get_summary(self, frame: int) -> FrameSummary | None:
        """Return the summary of a frame; None if unknown."""
        return self._known.get(frame)

    def find_unknown_frame(self, frame: int) -> int:
        """Return the unknown frame closest to `frame`, later ones first; -1 when all are known."""
        waiting = [i for i in range(self._n_frames) if i not in self._known]
        return min(waiting, key=lambda i: (abs(i - frame), -i), default=-1)

    @property
    def common_warnings(self) -> frozenset[str]:
        """Return the warnings that all known frames with contact share."""
        if self._common is None:
            warnings = [set(known.warnings) for known in self._known.values() if known.contact_area_mm2 > 0]
            self._common = frozenset[str]() if len(warnings) < 2 else frozenset(set.intersection(*warnings))
        return self._common

    def get_specific_warnings(self, frame: int) -> tuple[str, ...]:
        """Return the warnings of a frame that are not common to all frames."""
        known = self._known.get(frame)
        return () if known is None else tuple(doubt for doubt in known.warnings if doubt not in self.common_warnings)

    def get_values(self, figure: str) -> tuple[float, ...]:
        """Return a metric of every frame, NaN where unknown."""
        unknown = FrameSummary()
        return tuple(self._known.get(i, unknown).get_value(METRIC, figure) for i in range(self._n_frames))

    def reset_frames(self, n_frames: int) -> None:
        """Start over with this many unknown frames."""
        self.beginResetModel()
        self._n_frames = n_frames
        self._known, self._common = {}, None
        self.endResetModel()

    def grow_to(self, n_frames: int) -> None:
        """Add rows for new frames."""
        if n_frames > self._n_frames:
            self.beginInsertRows(QModelIndex(), self._n_frames, n_frames - 1)
            self._n_frames = n_frames
            self.endInsertRows()

    def clear_summaries(self) -> None:
        """Clear all summaries, because the settings changed."""
        if self._known:
            self._known, self._common = {}, None
            self._emit_changed(0, self._n_frames - 1)

    def show_metric(self, name: str, title: str) -> None:
        """Set the metric and title of the last column."""
        if (name, title) != (self._figure, self._title):
            self._figure, self._title = name, title
            self.headerDataChanged.emit(Qt.Orientation.Horizontal, METRIC, METRIC)
            self._emit_changed(0, self._n_frames - 1)

    def show_summary(self, frame: int, summary: FrameSummary) -> None:
        """Fill one row."""
        if self._known.get(frame) == summary or not 0 <= frame < self._n_frames:
            return
        self._known[frame], self._common = summary, None
        self._emit_changed(frame, frame)

    def show_notes(self, notes: Mapping[int, str]) -> None:
        """Show the notes of frames."""
        if notes != self._notes:
            self._notes = notes
            if self._n_frames:
                self.dataChanged.emit(self.index(0, NOTE), self.index(self._n_frames - 1, NOTE))

    def get_note(self, frame: int) -> str:
        """Return the note of a frame."""
        return self._notes.get(frame, "")

    def flags(self, index: QModelIndex) -> Qt.ItemFlag:
        """Make the note column editable."""
        usual = super().flags(index)
        return usual | Qt.ItemFlag.ItemIsEditable if index.column() == NOTE else usual

    def setData(self, index: QModelIndex, value: object, role: int = Qt.ItemDataRole.EditRole) -> bool:  # noqa: N802
        """Emit an edited note; its owner stores and shows it."""
        if not index.isValid() or index.column() != NOTE or role != Qt.ItemDataRole.EditRole:
            return False
        self.note_edited.emit(index.row(), str(value).strip())
        return True

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return one row per frame."""
        return 0 if parent.isValid() else self._n_frames

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return the number of columns: frame, depth, contact, metric, note."""
        return 0 if parent.isValid() else NOTE + 1

    def data(self, index: QModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return the text of a cell, or its sort value."""
        if not index.isValid():
            return None
        if index.column() == NOTE and role != SORT_ROLE:
            kept = self.get_note(index.row())
            shown = Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.EditRole, Qt.ItemDataRole.ToolTipRole
            return kept if role in shown else None
        if role in (Qt.ItemDataRole.ToolTipRole, Qt.ItemDataRole.DecorationRole):
            return self._remark(index.row(), index.column(), Qt.ItemDataRole(role))
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        if role == SORT_ROLE:
            return self._number(index.row(), index.column())
        return self._text(index.row(), index.column()) if role == Qt.ItemDataRole.DisplayRole else None

    def _remark(self, frame: int, column: int, role: Qt.ItemDataRole) -> object:
        """Return why a frame failed or has warnings, or the warning sign next to its number."""
        summary = self._known.get(frame)
        if summary is None:
            return None
        if role == Qt.ItemDataRole.ToolTipRole:
            return summary.problem or "\n".join(summary.warnings) or None
        return make_state_icon("warning") if column == FRAME and self.get_specific_warnings(frame) else None

    def _number(self, frame: int, column: int) -> float:
        if column == FRAME:
            return float(frame)
        if column == NOTE:
            return 1.0 if self.get_note(frame) else 0.0
        summary = self._known.get(frame)
        value = math.nan if summary is None else summary.get_value(column, self._figure)
        return value if math.isfinite(value) else -math.inf

    def _text(self, frame: int, column: int) -> str:
        summary = self._known.get(frame)
        if column == FRAME:
            return str(frame)
        if summary is None:
            return ""
        if summary.problem:
            return "failed" if column == METRIC else ""
        value = summary.get_value(column, self._figure)
        return f"{value:.{(2, 1, 3)[column - 1]}f}" if math.isfinite(value) else "-"

    def headerData(  # noqa: N802
        self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole
    ) -> object:
        """Return column titles and their tooltips."""
        if orientation == Qt.Orientation.Horizontal and section == NOTE:
            shown = {Qt.ItemDataRole.DisplayRole: "note", Qt.ItemDataRole.ToolTipRole: "your note on the frame"}
            return shown.get(Qt.ItemDataRole(role))
        if orientation == Qt.Orientation.Horizontal and 0 <= section <= METRIC:
            if role == Qt.ItemDataRole.DisplayRole:
                return self._title if section == METRIC else _TITLES[section]
            if role == Qt.ItemDataRole.ToolTipRole:
                return f"{self._figure}; - where unknown" if section == METRIC else _TIPS[section]
        return None

    def _emit_changed(self, first: int, last: int) -> None:
        if last >= first:
            self.dataChanged.emit(self.index(first, DEPTH), self.index(last, METRIC))
