"""Table of frames, sortable and filterable, with keys for the worst frames."""

import math
from collections.abc import Mapping

from PyQt6.QtCore import QModelIndex, QSize, Qt, pyqtSignal
from PyQt6.QtWidgets import QAbstractItemView, QHeaderView, QLabel, QWidget

from widgets.frames.frame_summary import FrameSummary
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
from widgets.style.styling import make_column
from widgets.style.tables import SORT_ROLE, FilteredTable, Terms

_FILTER = (
    "filter: >0.3, <2, contact, warned, noted, a word\n"
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
        self.table = FilteredTable("frames", self.model, self._get_terms, _FILTER)
        self._frame = 0
        self.metric_box = ChoiceBox("frames_figure", "metric of the frames", is_narrow=True)
        self._told = QLabel()
        self._prepare_table()
        make_column(
            3,
            self.metric_box,
            self.table.filter_line,
            self.table,
            self._told,
            around_px=(2, 2, 2, 2),
            on=self,
        )
        self.table.filter_line.textChanged.connect(self._tell_filtered)
        for chosen in (self.table.clicked, self.table.activated):  # a double click edits the note
            chosen.connect(self._choose_picked)
        for signal in (self.model.dataChanged, self.model.modelReset):
            signal.connect(self._tell)
        self._tell()

    def show_frame(self, frame: int) -> None:
        """Select the frame on screen."""
        self._frame = frame
        if 0 <= frame < self.model.rowCount():
            self.table.select_row(frame)

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
        ranked = [f for f in self.table.list_rows() if self._get_metric(f) != -math.inf]
        if not ranked:
            return
        at = ranked.index(self._frame) + by if self._frame in ranked else 0
        self.frame_chosen.emit(ranked[min(max(at, 0), len(ranked) - 1)])

    def _get_metric(self, frame: int) -> float:
        """Return what a frame is sorted by in the column of the metric."""
        return float(str(self.model.data(self.model.index(frame, METRIC), SORT_ROLE)))

    def _tell(self) -> None:
        frames = self.model.rowCount()
        done = sum(self.model.get_summary(i) is not None for i in range(frames))
        listed = self.table.listed.rowCount()
        some = f", {listed} listed" if listed != frames else ""
        self._told.setText(f"{done} of {frames} frames known{some}" if frames else "")

    def _tell_filtered(self) -> None:
        self._tell()
        self.show_frame(self._frame)

    def _choose_picked(self, index: QModelIndex) -> None:
        self.frame_chosen.emit(self.table.find_row(index))

    def _prepare_table(self) -> None:
        table = self.table
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        table.setEditTriggers(
            QAbstractItemView.EditTrigger.DoubleClicked
            | QAbstractItemView.EditTrigger.EditKeyPressed
        )
        table.setAlternatingRowColors(True)
        table.set_row_height(_ICON_PX[1] + 2)
        table.setIconSize(QSize(*_ICON_PX))
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
        table.columns.setSectionResizeMode(NOTE, QHeaderView.ResizeMode.Stretch)
        table.sort_from(FRAME)

    def _get_terms(self, frame: int) -> Terms:
        """Return what terms of the filter can hold for."""
        summary = self.model.get_summary(frame)
        known = summary or FrameSummary()
        has_contact = known.contact_area_mm2 > 0
        states = {
            "contact": has_contact,
            "no-contact": summary is not None and not (known.problem or has_contact),
            "warned": bool(self.model.get_specific_warnings(frame)),
            "noted": bool(self.model.get_note(frame)),
            "failed": bool(known.problem),
        }
        texts = (self.model.get_note(frame), *known.warnings, known.problem)
        return self._get_metric(frame), states, texts
