"""The table of frames: what is known of each, sorted by any of it, the worst one key away."""

from __future__ import annotations

import math

from PyQt6.QtCore import QModelIndex, QSignalBlocker, QSortFilterProxyModel, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from widgets.frames_filter import FramesFilter
from widgets.frames_model import FIGURE, FRAME, NOTE, SORTED_BY, FramesModel
from widgets.looks import smaller, spaced


class FramesPanel(QWidget):
    """Shows its `known` frames; `frame_chosen` says which row was picked, `figure_chosen` what the last column is."""

    frame_chosen = pyqtSignal(int)
    figure_chosen = pyqtSignal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.known = FramesModel(self)
        self._sorted = FramesFilter(self)
        self._sorted.setSourceModel(self.known)
        self._sorted.setSortRole(SORTED_BY)
        self._frame = 0
        self.figure, self._told, self.wanted = QComboBox(), QLabel(), QLineEdit()
        self.wanted.setObjectName("frames_filter")
        self.wanted.setAccessibleName("which frames are listed")
        self.wanted.setPlaceholderText("filter: >0.3, <2, touched, doubted, noted, a word")
        self.wanted.setToolTip("Frames of which all of these hold: a limit of the figure, touched, doubted, noted, "
                               "or a word of a note or a doubt")  # fmt: skip
        self.wanted.setClearButtonEnabled(True)
        self.wanted.textChanged.connect(self._filter)
        self.figure.setObjectName("frames_figure")
        self.figure.setAccessibleName("figure of the frames")
        self.figure.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.figure.activated.connect(lambda: self.figure_chosen.emit(self.figure.currentText()))
        smaller(self._told, 1.0)
        self.table = _table(self._sorted)
        layout = spaced(QVBoxLayout(self), 3, (2, 2, 2, 2))
        for widget in (self.figure, self.wanted, self.table, self._told):
            layout.addWidget(widget)
        self.table.clicked.connect(self._picked)  # a double click writes a note
        self.table.activated.connect(self._picked)
        for signal in (self.known.dataChanged, self.known.modelReset):
            signal.connect(self._tell)
        self._tell()

    def show_frame(self, frame: int) -> None:
        """Mark the frame that is on screen."""
        self._frame = frame
        if not 0 <= frame < self.known.rowCount():
            return
        row = self._sorted.mapFromSource(self.known.index(frame, 0))
        if not row.isValid():  # not among those that are listed
            self.table.clearSelection()
            return
        if self.table.currentIndex().row() != row.row():
            self.table.setCurrentIndex(row)
        self.table.scrollTo(row)

    def offer_figures(self, names: tuple[str, ...], chosen: str, title: str) -> None:
        """The figures to choose from, and the one that the last column shows; says nothing to anybody."""
        with QSignalBlocker(self.figure):
            if tuple(self.figure.itemText(i) for i in range(self.figure.count())) != names:
                self.figure.clear()
                self.figure.addItems(names)
            self.figure.setCurrentText(chosen)
        self.figure.setEnabled(bool(names))
        self.known.show_figure(chosen, title)

    def step(self, by: int, *, worst_first: Qt.SortOrder) -> None:
        """Go `by` rows along the frames in order of the figure, those without one left out; no further than the ends.

        The table takes that order; from a frame that has no figure, the first of the order comes.
        """
        self.table.sortByColumn(FIGURE, worst_first)
        frames = [self._frame_of(row) for row in range(self._sorted.rowCount())]
        ranked = [f for f in frames if self.known.data(self.known.index(f, FIGURE), SORTED_BY) != -math.inf]
        if not ranked:
            return
        at = ranked.index(self._frame) + by if self._frame in ranked else 0
        self.frame_chosen.emit(ranked[min(max(at, 0), len(ranked) - 1)])

    def _frame_of(self, row: int) -> int:
        return self._sorted.mapToSource(self._sorted.index(row, FRAME)).row()

    def _tell(self) -> None:
        frames = self.known.rowCount()
        done = sum(self.known.known(i) is not None for i in range(frames))
        listed = self._sorted.rowCount()
        some = f", {listed} listed" if listed != frames else ""
        self._told.setText(f"{done} of {frames} frames known{some}" if frames else "")

    def _filter(self, words: str) -> None:
        self._sorted.show_only(words)
        self._tell()
        self.show_frame(self._frame)

    def _picked(self, index: QModelIndex) -> None:
        self.frame_chosen.emit(self._frame_of(index.row()))


def _table(model: QSortFilterProxyModel) -> QTableView:
    table = QTableView()
    table.setObjectName("frames")
    table.setModel(model)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
    table.setShowGrid(False)
    table.setAlternatingRowColors(True)
    rows, columns = table.verticalHeader(), table.horizontalHeader()
    assert rows is not None
    assert columns is not None
    rows.hide()
    rows.setDefaultSectionSize(table.fontMetrics().height() + 5)
    columns.setMinimumSectionSize(30)
    columns.setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
    columns.setSectionResizeMode(FRAME, QHeaderView.ResizeMode.ResizeToContents)
    columns.setSectionResizeMode(NOTE, QHeaderView.ResizeMode.Stretch)
    columns.setSortIndicator(FRAME, Qt.SortOrder.AscendingOrder)
    table.setSortingEnabled(True)
    return table
