"""Table of frames, sortable and filterable, with keys for the worst frames."""

import math
from collections.abc import Mapping
from functools import partial

from PyQt6.QtCore import QModelIndex, QSize, QSortFilterProxyModel, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QHeaderView,
    QLabel,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from widgets.frames.frames_model import (
    CAUSE,
    CONTACT,
    DEPTH,
    FRAME,
    METRIC,
    NOTE,
    WARNINGS,
    FramesModel,
)
from widgets.style.base import ChoiceBox
from widgets.style.styling import fill, make_search_line, set_spacing
from widgets.style.tables import (
    SORT_ROLE,
    RowFilter,
    matches_limit,
    prepare_table,
)

_HINT = "filter: >0.3, <2, contact, warned, noted, a word"
_FILTER_TIP = (
    "Frames that match all terms: a limit of the metric, contact, warned, noted, or a "
    "word of a note or a warning"
)
_ICON_PX = 40, 30


class FramesPanel(QWidget):
    """Shows the frames `model`; `frame_chosen` carries the selected frame."""

    frame_chosen = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__()
        self.model = FramesModel(self)
        self._sorted = RowFilter(self.model, partial(_matches_term, self.model))
        self._frame = 0
        self.metric_box = ChoiceBox("frames_figure", "metric of the frames")
        self._told = QLabel()
        self.filter_line = make_search_line(
            "frames_filter", "filter of the frames", _HINT, _FILTER_TIP
        )
        self.filter_line.textChanged.connect(self._filter)
        self.metric_box.setSizeAdjustPolicy(
            QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
        )
        self.table = _table(self._sorted)
        layout = set_spacing(QVBoxLayout(self), 3, (2, 2, 2, 2))
        fill(layout, self.metric_box, self.filter_line, self.table, self._told)
        self.table.clicked.connect(self._choose_picked)  # a double click edits the note
        self.table.activated.connect(self._choose_picked)
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
        self.metric_box.offer(names, chosen)
        self.metric_box.setEnabled(bool(names))
        self.model.show_metric(chosen, title, names.get(chosen, chosen))

    def step_by_metric(self, by: int, *, sort_order: Qt.SortOrder) -> None:
        """Move by `by` frames in the order of the metric, without frames that lack it.

        Stops at the ends.

        The table takes that order. From a frame without the metric, the first one of the order is
        chosen.
        """
        self.table.sortByColumn(METRIC, sort_order)
        frames = [self._frame_of(row) for row in range(self._sorted.rowCount())]
        ranked = [
            f
            for f in frames
            if self.model.data(self.model.index(f, METRIC), SORT_ROLE) != -math.inf
        ]
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

    def _filter(self, words: str) -> None:
        self._sorted.set_filter(words)
        self._tell()
        self.show_frame(self._frame)

    def _choose_picked(self, index: QModelIndex) -> None:
        self.frame_chosen.emit(self._frame_of(index.row()))


def _table(model: QSortFilterProxyModel) -> QTableView:
    table = QTableView()
    columns = prepare_table(table, "frames", "frames")
    table.setModel(model)
    table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
    table.setEditTriggers(
        QAbstractItemView.EditTrigger.DoubleClicked | QAbstractItemView.EditTrigger.EditKeyPressed
    )
    table.setAlternatingRowColors(True)
    rows = table.verticalHeader()
    assert rows is not None
    rows.setDefaultSectionSize(_ICON_PX[1] + 2)
    table.setIconSize(QSize(*_ICON_PX))
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
        icon_px = {FRAME: _ICON_PX[0] + 6, WARNINGS: 8}.get(column, 0)
        table.setColumnWidth(column, table.fontMetrics().horizontalAdvance(text) + icon_px + 16)
    columns.setSectionResizeMode(NOTE, QHeaderView.ResizeMode.Stretch)
    columns.setSortIndicator(FRAME, Qt.SortOrder.AscendingOrder)
    table.setSortingEnabled(True)
    return table


def _matches_term(model: FramesModel, frame: int, word: str) -> bool:
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
    texts = (
        model.get_note(frame),
        *(() if summary is None else (*summary.warnings, summary.problem)),
    )
    return any(word in text.lower() for text in texts)
