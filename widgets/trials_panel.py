"""Table of the rollouts of a task, with a filter."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QModelIndex, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QHeaderView,
    QLabel,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from pipeline.tasks.trial_rows import TrialRow
from widgets.fonts import resize_font
from widgets.frames_filter import RowFilter
from widgets.styling import fill, make_search_line, set_spacing
from widgets.table_copier import copy_table, prepare_table
from widgets.trials_model import CAUSE, TRIAL, TrialsModel, matches_term

_HINT = "filter: fails, t2t, hex_key, >0.5, a word"
_FILTER_TIP = "Trials that match all terms: a limit of the error in mm, or a word of any column"
_CAUSE_PX = 320


class TrialsPanel(QWidget):
    """Filter over table over the number of rows; `trial_chosen` carries the path of the selected rollout."""

    trial_chosen = pyqtSignal(Path)

    def __init__(self) -> None:
        super().__init__()
        self.model = TrialsModel(self)
        self._listed = RowFilter(self.model, partial(matches_term, self.model))
        self.filter_line = make_search_line("trials_filter", "filter of the trials", _HINT, _FILTER_TIP)
        self.table, self._count = QTableView(), QLabel()
        self.filter_line.textChanged.connect(self._filter)
        resize_font(self._count)
        resize_font(self.table)
        self._prepare_table()
        fill(set_spacing(QVBoxLayout(self), 3, (2, 2, 2, 2)), self.filter_line, self.table, self._count)

    def _prepare_table(self) -> None:
        table = self.table
        columns = prepare_table(table, "trials", "trials")
        table.setModel(self._listed)
        table.setAlternatingRowColors(True)
        columns.setMinimumSectionSize(30)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        columns.setSectionResizeMode(CAUSE, QHeaderView.ResizeMode.Interactive)
        columns.resizeSection(CAUSE, _CAUSE_PX)
        columns.setSortIndicator(TRIAL, Qt.SortOrder.AscendingOrder)
        table.setSortingEnabled(True)
        table.clicked.connect(self._choose)
        table.activated.connect(self._choose)

    @property
    def listed_trials(self) -> tuple[TrialRow, ...]:
        """The rollouts on display in their order."""
        return tuple(self._get_trial(self._listed.index(row, 0)) for row in range(self._listed.rowCount()))

    def show_trials(self, trials: Sequence[TrialRow]) -> None:
        """Show these rollouts."""
        if tuple(trials) != self.model.trials:
            self.model.show_trials(trials)
            self._show_count()

    def show_trial(self, path: Path | None) -> None:
        """Select the rollout on screen."""
        row = next((k for k, trial in enumerate(self.model.trials) if trial.path == path), -1)
        index = self._listed.mapFromSource(self.model.index(row, TRIAL)) if row >= 0 else QModelIndex()
        if not index.isValid():
            self.table.clearSelection()
        elif index.row() not in {one.row() for one in self.table.selectedIndexes()}:
            self.table.setCurrentIndex(index)
            self.table.scrollTo(index)

    def step_by(self, by: int) -> None:
        """Choose the next or previous listed rollout that can be read."""
        trials = self.listed_trials
        rows = [k for k, trial in enumerate(trials) if not trial.problem]
        at = next((n for n, k in enumerate(rows) if k == self.table.currentIndex().row()), -by if by > 0 else len(rows))
        if rows and 0 <= at + by < len(rows):
            self.trial_chosen.emit(trials[rows[at + by]].path)

    def copy_rows(self) -> None:
        """Copy the selected rollouts as a table, all listed ones where at most one is selected."""
        selected = {index.row() for index in self.table.selectedIndexes()}
        copy_table(self.table, only_selected=len(selected) > 1)

    def _filter(self, words: str) -> None:
        self._listed.set_filter(words)
        self._show_count()

    def _show_count(self) -> None:
        trials, listed = self.model.trials, self.listed_trials
        fails = sum(trial.outcome == "fails" for trial in listed)
        of = "" if len(listed) == len(trials) else f" of {len(trials)}"
        self._count.setText(f"{len(listed)}{of} trials, {fails} fail" if trials else "")

    def _get_trial(self, index: QModelIndex) -> TrialRow:
        return self.model.trials[self._listed.mapToSource(index).row()]

    def _choose(self, index: QModelIndex) -> None:
        if len({one.row() for one in self.table.selectedIndexes()}) <= 1:
            self.trial_chosen.emit(self._get_trial(index).path)
