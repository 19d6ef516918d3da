"""Table of the rollouts of a task, with a filter."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QModelIndex, QObject, Qt, pyqtSignal
from PyQt6.QtWidgets import QHeaderView, QLabel, QTableView, QVBoxLayout, QWidget

from pipeline.lab.tasks.trial_rows import TrialRow
from widgets.style.icons import make_state_icon
from widgets.style.styling import fill, make_search_line, set_spacing
from widgets.style.tables import (
    RowFilter,
    RowsModel,
    copy_table,
    matches_limit,
    prepare_table,
)

_HINT = "filter: fails, t2t, >0.5, a word"
_FILTER_TIP = "Trials that match all terms: a limit of the error in mm, or a word of any column"
_CAUSE_PX = 320
TRIAL, CASE, TOUCH, TOLERANCE, OUTCOME, ERROR_MM, ERROR_DEG, CAUSE, TASK = range(9)
_TITLES = (
    "trial",
    "case",
    "touch",
    "clear\nmm",
    "outcome",
    "error\nmm",
    "error\n°",
    "cause",
    "task",
)
_TIPS = (
    "trial number: equal numbers start alike",
    "object or tool",
    "touch that the controller reads",
    "clearance or tolerance, mm",
    "outcome of the rollout",
    "error of the worst decision, mm",
    "error of its angle, degrees",
    "how the rollout ends, and the largest share of its error",
    "task",
)
_ICONS = {"succeeds": "computed", "fails": "failed", "damaged": "warning"}


class TrialsModel(RowsModel):
    """One row per rollout."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(_TITLES, _TIPS, parent)
        self.trials: tuple[TrialRow, ...] = ()

    def show_trials(self, trials: Sequence[TrialRow]) -> None:
        """Show these rollouts."""
        self.beginResetModel()
        self.trials = tuple(trials)
        self.n_rows = len(trials)
        self.endResetModel()

    def format_cell(self, row: int, column: int) -> str:
        """Return the text of a cell."""
        return format_cell(self.trials[row], column)

    def get_number(self, row: int, column: int) -> float | None:
        """Return the number of a cell; None for a column of texts."""
        return _get_number(self.trials[row], column)

    def get_picture(self, row: int, column: int) -> object:
        """Return the sign of the outcome."""
        return make_state_icon(_ICONS[self.trials[row].outcome]) if column == OUTCOME else None

    def get_tip(self, row: int, column: int) -> str:  # noqa: ARG002 - of the row
        """Return how a rollout ended."""
        trial = self.trials[row]
        return trial.problem or f"{trial.path.name}: {format_cell(trial, CAUSE)}"


def format_cell(trial: TrialRow, column: int) -> str:
    """Return the text of a cell."""
    if trial.problem:
        return {CASE: trial.path.name, OUTCOME: trial.outcome, CAUSE: trial.problem}.get(column, "")
    number = _get_number(trial, column)
    if number is not None:
        digits = {TRIAL: "d", TOLERANCE: "g", ERROR_MM: ".2f", ERROR_DEG: ".1f"}[column]
        return (
            format(int(number) if column == TRIAL else number, digits)
            if math.isfinite(number)
            else "-"
        )
    cause = ": ".join(filter(None, (trial.cause, trial.share)))
    return {
        TASK: trial.task,
        CASE: trial.case,
        TOUCH: trial.touch,
        OUTCOME: trial.outcome,
        CAUSE: cause,
    }[column]


def _get_number(trial: TrialRow, column: int) -> float | None:
    """Return the number of a cell; None for a column of texts."""
    numbers = {
        TRIAL: float(trial.trial),
        TOLERANCE: trial.tolerance_mm,
        ERROR_MM: trial.error_mm,
        ERROR_DEG: trial.error_deg,
    }
    return numbers.get(column)


def matches_term(model: TrialsModel, row: int, word: str) -> bool:
    """Return whether a filter term holds for a rollout: a limit of the error in mm, or a word of
    any cell.
    """
    trial = model.trials[row]
    is_within = matches_limit(word, trial.error_mm)
    if is_within is not None:
        return is_within
    return any(word in format_cell(trial, column).lower() for column in range(len(_TITLES)))


class TrialsPanel(QWidget):
    """Filter over table over the number of rows.

    `trial_chosen` carries the path of the selected rollout.
    """

    trial_chosen = pyqtSignal(Path)

    def __init__(self) -> None:
        super().__init__()
        self.model = TrialsModel(self)
        self._listed = RowFilter(self.model, partial(matches_term, self.model))
        self.filter_line = make_search_line(
            "trials_filter", "filter of the trials", _HINT, _FILTER_TIP
        )
        self.table = QTableView()
        self._count = QLabel()
        self.filter_line.textChanged.connect(self._filter)
        self._prepare_table()
        fill(
            set_spacing(QVBoxLayout(self), 3, (2, 2, 2, 2)),
            self.filter_line,
            self.table,
            self._count,
        )

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
        return tuple(
            self._get_trial(self._listed.index(row, 0)) for row in range(self._listed.rowCount())
        )

    def show_trials(self, trials: Sequence[TrialRow]) -> None:
        """Show these rollouts."""
        if tuple(trials) != self.model.trials:
            self.model.show_trials(trials)
            self._show_count()

    def show_trial(self, path: Path | None) -> None:
        """Select the rollout on screen."""
        row = next((k for k, trial in enumerate(self.model.trials) if trial.path == path), -1)
        index = (
            self._listed.mapFromSource(self.model.index(row, TRIAL)) if row >= 0 else QModelIndex()
        )
        if not index.isValid():
            self.table.clearSelection()
        elif index.row() not in {one.row() for one in self.table.selectedIndexes()}:
            self.table.setCurrentIndex(index)
            self.table.scrollTo(index)

    def step_by(self, by: int) -> None:
        """Choose the next or previous listed rollout that can be read."""
        trials = self.listed_trials
        rows = [k for k, trial in enumerate(trials) if not trial.problem]
        at = next(
            (n for n, k in enumerate(rows) if k == self.table.currentIndex().row()),
            -by if by > 0 else len(rows),
        )
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
        trials = self.model.trials
        listed = self.listed_trials
        fails = sum(trial.outcome == "fails" for trial in listed)
        of = "" if len(listed) == len(trials) else f" of {len(trials)}"
        self._count.setText(f"{len(listed)}{of} trials, {fails} fail" if trials else "")

    def _get_trial(self, index: QModelIndex) -> TrialRow:
        return self.model.trials[self._listed.mapToSource(index).row()]

    def _choose(self, index: QModelIndex) -> None:
        if len({one.row() for one in self.table.selectedIndexes()}) <= 1:
            self.trial_chosen.emit(self._get_trial(index).path)
