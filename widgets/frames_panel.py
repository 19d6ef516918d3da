"""The list of frames, with what is known of each so far."""

from __future__ import annotations

from dataclasses import dataclass

from PyQt6.QtCore import QAbstractTableModel, QModelIndex, Qt, pyqtSignal
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QTableView, QWidget

_COLUMNS = ("frame", "depth\nmm", "contact\nmm²", "error\nmm")
_TIPS = (
    "number of the frame",
    "largest indentation of the source sensor, mm",
    "contact area on the source sensor, mm²",
    "mean absolute error of the generated indentation inside the true contact, mm; - where none is known",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSummary:
    """What one frame turned out to be."""

    deepest_mm: float
    contact_mm2: float
    error_mm: float | None  # of the generated touch; None = no truth of the target, or nothing generated

    def cells(self) -> tuple[str, str, str]:
        """As shown."""
        if self.contact_mm2 <= 0:
            return "-", "0", ""
        error = "-" if self.error_mm is None else f"{self.error_mm:.3f}"
        return f"{self.deepest_mm:.2f}", f"{self.contact_mm2:.1f}", error


class FramesModel(QAbstractTableModel):
    """Frame numbers and their summaries; a frame nobody has looked at costs nothing."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._n_frames = 0
        self._known: dict[int, FrameSummary] = {}

    def show_frames(self, n_frames: int) -> None:
        """Start over with this many frames of which nothing is known."""
        self.beginResetModel()
        self._n_frames = n_frames
        self._known = {}
        self.endResetModel()

    def forget(self) -> None:
        """Empty every row: what was known was worked out otherwise than what follows."""
        if self._known:
            self._known = {}
            self.dataChanged.emit(self.index(0, 1), self.index(self._n_frames - 1, len(_COLUMNS) - 1))

    def show_summary(self, frame: int, summary: FrameSummary) -> None:
        """Fill one row."""
        if self._known.get(frame) == summary or not 0 <= frame < self._n_frames:
            return
        self._known[frame] = summary
        self.dataChanged.emit(self.index(frame, 1), self.index(frame, len(_COLUMNS) - 1))

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """One row a frame."""
        return 0 if parent.isValid() else self._n_frames

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Frame, depth, contact, error."""
        return 0 if parent.isValid() else len(_COLUMNS)

    def data(self, index: QModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """The text of a cell."""
        if not index.isValid():
            return None
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        if role != Qt.ItemDataRole.DisplayRole:
            return None
        if index.column() == 0:
            return str(index.row())
        summary = self._known.get(index.row())
        return "" if summary is None else summary.cells()[index.column() - 1]

    def headerData(  # noqa: N802
        self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole
    ) -> object:
        """Column titles and their explanations."""
        if orientation == Qt.Orientation.Horizontal and 0 <= section < len(_COLUMNS):
            if role == Qt.ItemDataRole.DisplayRole:
                return _COLUMNS[section]
            if role == Qt.ItemDataRole.ToolTipRole:
                return _TIPS[section]
        return None


class FramesPanel(QTableView):
    """The table of `known` frames; `frame_chosen` says which row was picked."""

    frame_chosen = pyqtSignal(int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.known = FramesModel(self)
        self.setObjectName("frames")
        self.setModel(self.known)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.setShowGrid(False)
        self.setAlternatingRowColors(True)
        rows, columns = self.verticalHeader(), self.horizontalHeader()
        assert rows is not None
        assert columns is not None
        rows.hide()
        rows.setDefaultSectionSize(self.fontMetrics().height() + 5)
        columns.setMinimumSectionSize(30)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        columns.setSectionResizeMode(0, QHeaderView.ResizeMode.ResizeToContents)
        self.clicked.connect(self._picked)
        self.activated.connect(self._picked)

    def show_frame(self, frame: int) -> None:
        """Mark the frame that is on screen."""
        if self.currentIndex().row() != frame and 0 <= frame < self.known.rowCount():
            self.setCurrentIndex(self.known.index(frame, 0))
        self.scrollTo(self.known.index(frame, 0))

    def _picked(self, index: QModelIndex) -> None:
        self.frame_chosen.emit(index.row())
