"""Table of frames, sortable and filterable, with keys for the worst frames."""

from __future__ import annotations

import math
from collections.abc import Mapping

from PyQt6.QtCore import QModelIndex, QSignalBlocker, QSize, QSortFilterProxyModel, Qt, pyqtSignal
from PyQt6.QtGui import QShowEvent
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

from widgets.eliding_combo_box import ElidingComboBox
from widgets.fonts import resize_font
from widgets.frame_summary import THUMBNAIL_PX
from widgets.frames_filter import FramesFilter, get_limits, replace_limits
from widgets.frames_model import CAUSE, CONTACT, DEPTH, FRAME, METRIC, NOTE, SORT_ROLE, WARNINGS, FramesModel
from widgets.metric_histogram import MetricHistogram
from widgets.styling import make_single_shot_timer, set_spacing

_HISTOGRAM_DELAY_MS = 60  # values that arrive within it are drawn together


class FramesPanel(QWidget):
    """Shows the frames `model`; `frame_chosen` carries the selected frame, `metric_chosen` the name of a metric."""

    frame_chosen = pyqtSignal(int)
    metric_chosen = pyqtSignal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.model = FramesModel(self)
        self._sorted = FramesFilter(self)
        self._sorted.setSourceModel(self.model)
        self._sorted.setSortRole(SORT_ROLE)
        self._frame = 0
        self.metric_box, self._told, self.filter_line = ElidingComboBox(), QLabel(), QLineEdit()
        self.filter_line.setObjectName("frames_filter")
        self.filter_line.setAccessibleName("filter of the frames")
        self.filter_line.setPlaceholderText("filter: >0.3, <2, contact, warned, noted, a word")
        self.filter_line.setToolTip("Frames that match all terms: a limit of the metric, contact, warned, "
                               "noted, or a word of a note or a warning")  # fmt: skip
        self.filter_line.setClearButtonEnabled(True)
        self.filter_line.textChanged.connect(self._filter)
        self.metric_box.setObjectName("frames_figure")
        self.metric_box.setAccessibleName("metric of the frames")
        self.metric_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.metric_box.activated.connect(lambda: self.metric_chosen.emit(self.metric_box.currentData()))
        resize_font(self._told)
        self.histogram = MetricHistogram()
        self.histogram.range_chosen.connect(self._choose_range)
        self.table = _table(self._sorted)
        layout = set_spacing(QVBoxLayout(self), 3, (2, 2, 2, 2))
        for widget in (self.metric_box, self.histogram, self.filter_line, self.table, self._told):
            layout.addWidget(widget)
        self.table.clicked.connect(self._choose_picked)  # a double click edits the note
        self.table.activated.connect(self._choose_picked)
        self._histogram_timer = make_single_shot_timer(self, _HISTOGRAM_DELAY_MS, self._show_histogram)
        for signal in (self.model.dataChanged, self.model.modelReset):
            signal.connect(self._tell)
        self._tell()

    def show_frame(self, frame: int) -> None:
        """Select the frame on screen."""
        self._frame = frame
        if not 0 <= frame < self.model.rowCount():
            return
        row = self._sorted.mapFromSource(self.model.index(frame, 0))
        if not row.isValid():  # not listed
            self.table.clearSelection()
            return
        if self.table.currentIndex().row() != row.row():
            self.table.setCurrentIndex(row)
        self.table.scrollTo(row)

    def offer_metrics(self, names: Mapping[str, str], chosen: str, title: str) -> None:
        """Offer the metrics (name -> text) and the title of the selected one; emits no signal."""
        with QSignalBlocker(self.metric_box):
            if [self.metric_box.itemData(i) for i in range(self.metric_box.count())] != list(names):
                self.metric_box.clear()
                for name, text in names.items():
                    self.metric_box.addItem(text, name)
            self.metric_box.setCurrentIndex(self.metric_box.findData(chosen))
        self.metric_box.setEnabled(bool(names))
        self.model.show_metric(chosen, title, names.get(chosen, chosen))
        self._histogram_timer.start()

    def step_by_metric(self, by: int, *, sort_order: Qt.SortOrder) -> None:
        """Move by `by` frames in the order of the metric, without frames that lack it; stops at the ends.

        The table takes that order. From a frame without the metric, the first one of the order is chosen.
        """
        self.table.sortByColumn(METRIC, sort_order)
        frames = [self._frame_of(row) for row in range(self._sorted.rowCount())]
        ranked = [f for f in frames if self.model.data(self.model.index(f, METRIC), SORT_ROLE) != -math.inf]
        if not ranked:
            return
        at = ranked.index(self._frame) + by if self._frame in ranked else 0
        self.frame_chosen.emit(ranked[min(max(at, 0), len(ranked) - 1)])

    def _frame_of(self, row: int) -> int:
        return self._sorted.mapToSource(self._sorted.index(row, FRAME)).row()

    def _tell(self) -> None:
        frames = self.model.rowCount()
        done = sum(self.model.get_summary(i) is not None for i in range(frames))
        listed = self._sorted.rowCount()
        some = f", {listed} listed" if listed != frames else ""
        self._told.setText(f"{done} of {frames} frames known{some}" if frames else "")
        self._histogram_timer.start()

    def showEvent(self, a0: QShowEvent | None) -> None:  # noqa: N802
        """Draw the histogram, which is not drawn while the panel is hidden."""
        super().showEvent(a0)
        self._show_histogram()

    def _show_histogram(self) -> None:
        if self.isVisible():
            values = self.model.get_values(str(self.metric_box.currentData() or ""))
            self.histogram.show_values(values, get_limits(self.filter_line.text()))

    def _choose_range(self, low: float, high: float) -> None:
        self.filter_line.setText(replace_limits(self.filter_line.text(), low, high))

    def _filter(self, words: str) -> None:
        self._sorted.set_filter(words)
        self._tell()
        self.show_frame(self._frame)

    def _choose_picked(self, index: QModelIndex) -> None:
        self.frame_chosen.emit(self._frame_of(index.row()))


def _table(model: QSortFilterProxyModel) -> QTableView:
    table = QTableView()
    table.setObjectName("frames")
    table.setAccessibleName("frames")
    table.setModel(model)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
    table.setShowGrid(False)
    table.setAlternatingRowColors(True)
    rows, columns = table.verticalHeader(), table.horizontalHeader()
    assert rows is not None
    assert columns is not None
    rows.hide()
    rows.setDefaultSectionSize(THUMBNAIL_PX[1] + 2)
    table.setIconSize(QSize(*THUMBNAIL_PX))
    columns.setMinimumSectionSize(30)
    columns.setSectionResizeMode(QHeaderView.ResizeMode.Interactive)
    widest = {
        FRAME: "0000",
        METRIC: "00.000",
        CAUSE: "target depth",
        DEPTH: "depth",
        CONTACT: "0000.0",
        WARNINGS: "warn",
    }
    for column, text in widest.items():
        icon_px = {FRAME: THUMBNAIL_PX[0] + 6, WARNINGS: 8}.get(column, 0)
        table.setColumnWidth(column, table.fontMetrics().horizontalAdvance(text) + icon_px + 16)
    columns.setSectionResizeMode(NOTE, QHeaderView.ResizeMode.Stretch)
    columns.setSortIndicator(FRAME, Qt.SortOrder.AscendingOrder)
    table.setSortingEnabled(True)
    return table
