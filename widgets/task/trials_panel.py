"""Table of the rollouts of a task, with a filter."""

from collections.abc import Sequence
from pathlib import Path

from PyQt6.QtCore import QModelIndex, pyqtSignal
from PyQt6.QtGui import QStandardItem
from PyQt6.QtWidgets import QHeaderView, QLabel, QWidget

from pipeline.lab.tasks.trial_rows import TrialRow
from widgets.style.icons import make_state_icon
from widgets.style.styling import make_column
from widgets.style.tables import FilteredTable, Terms, copy_table, make_cells, make_titled_model

_FILTER = (
    "filter: fails, t2t, >0.5, a word\n"
    "Trials that match all terms: a limit of the error in mm, or a word of any column"
)
_CAUSE_PX = 320
TRIAL, _, _, _, OUTCOME, ERROR_MM, _, CAUSE, _ = range(9)
_COLUMNS = (
    ("trial", "trial number: equal numbers start alike", "d"),
    ("case", "object or tool", ""),
    ("touch", "touch that the controller reads", ""),
    ("clear\nmm", "clearance or tolerance, mm", "g"),
    ("outcome", "outcome of the rollout", ""),
    ("error\nmm", "error of the worst decision, mm", ".2f"),
    ("error\n°", "error of its angle, degrees", ".1f"),
    ("cause", "how the rollout ends, and the largest share of its error", ""),
    ("task", "task", ""),
)
_ICONS = {"succeeds": "computed", "fails": "failed", "damaged": "warning"}


def _make_row(trial: TrialRow) -> list[QStandardItem]:
    """Return the cells of a rollout, with the sign of its outcome."""
    cause = ": ".join(filter(None, (trial.cause, trial.share)))
    name, outcome = trial.path.name, trial.outcome
    cells = make_cells(
        _COLUMNS,
        ("", name, "", "", outcome, "", "", trial.problem, "")
        if trial.problem
        else (
            trial.trial,
            trial.case,
            trial.touch,
            trial.tolerance_mm,
            outcome,
            trial.error_mm,
            trial.error_deg,
            cause,
            trial.task,
        ),
        trial.problem or f"{name}: {cause}",
        "-",
    )
    cells[OUTCOME].setIcon(make_state_icon(_ICONS[outcome]))
    return cells


class TrialsPanel(QWidget):
    """Filter over table over the number of rows.

    `trial_chosen` carries the path of the selected rollout.
    """

    trial_chosen = pyqtSignal(Path)

    def __init__(self) -> None:
        super().__init__()
        self.trials: tuple[TrialRow, ...] = ()
        self._model = make_titled_model(_COLUMNS, self)
        self.table = FilteredTable("trials", self._model, self._get_terms, _FILTER)
        self._count = QLabel()
        self.table.filter_line.textChanged.connect(self._show_count)
        self.table.setAlternatingRowColors(True)
        columns = self.table.columns
        columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        columns.setSectionResizeMode(CAUSE, QHeaderView.ResizeMode.Interactive)
        columns.resizeSection(CAUSE, _CAUSE_PX)
        self.table.sort_from(TRIAL)
        for chosen in (self.table.clicked, self.table.activated):
            chosen.connect(self._choose)
        make_column(
            3, self.table.filter_line, self.table, self._count, around_px=(2, 2, 2, 2), on=self
        )

    @property
    def listed_trials(self) -> tuple[TrialRow, ...]:
        """The rollouts on display in their order."""
        return tuple(self.trials[row] for row in self.table.list_rows())

    def show_trials(self, trials: Sequence[TrialRow]) -> None:
        """Show these rollouts."""
        if tuple(trials) != self.trials:
            self._model.setRowCount(0)
            self.trials = tuple(trials)
            for trial in trials:
                self._model.appendRow(_make_row(trial))
            self._show_count()

    def show_trial(self, path: Path | None) -> None:
        """Select the rollout on screen."""
        paths = [trial.path for trial in self.trials]
        self.table.select_row(paths.index(path) if path in paths else -1)

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
        copy_table(self.table, only_selected=self._n_selected > 1)

    def _show_count(self) -> None:
        trials = self.trials
        listed = self.listed_trials
        fails = sum(trial.outcome == "fails" for trial in listed)
        of = "" if len(listed) == len(trials) else f" of {len(trials)}"
        self._count.setText(f"{len(listed)}{of} trials, {fails} fail" if trials else "")

    def _get_terms(self, row: int) -> Terms:
        """Return what terms of the filter can hold for: the error, and the words of any cell."""
        cells = (self._model.item(row, column) for column in range(len(_COLUMNS)))
        return self.trials[row].error_mm, {}, [cell.text() for cell in cells if cell is not None]

    @property
    def _n_selected(self) -> int:
        return len({one.row() for one in self.table.selectedIndexes()})

    def _choose(self, index: QModelIndex) -> None:
        if self._n_selected <= 1:
            self.trial_chosen.emit(self.trials[self.table.find_row(index)].path)
