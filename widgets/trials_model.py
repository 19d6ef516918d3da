"""Table model of the rollouts of a task: texts of the cells, and values to sort and filter by."""

import math
from collections.abc import Sequence

from PyQt6.QtCore import QAbstractTableModel, QModelIndex, Qt
from PyQt6.QtWidgets import QWidget

from pipeline.tasks.trial_rows import TrialRow
from widgets.frames_filter import matches_limit
from widgets.frames_model import SORT_ROLE
from widgets.icons import make_state_icon

TRIAL, CASE, TOUCH, TOLERANCE, OUTCOME, ERROR_MM, ERROR_DEG, CAUSE, TASK = range(9)
_TITLES = ("trial", "case", "touch", "clear\nmm", "outcome", "error\nmm", "error\n°", "cause", "task")
_TIPS = (
    "trial number: equal numbers start alike", "object or tool", "touch that the controller reads",
    "clearance or tolerance, mm", "outcome of the rollout", "error of the worst decision, mm",
    "error of its angle, degrees", "how the rollout ends, and the largest share of its error", "task",
)  # fmt: skip
_ICONS = {"succeeds": "computed", "fails": "failed", "damaged": "warning"}
_RIGHT = int(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)


class TrialsModel(QAbstractTableModel):
    """One row per rollout."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.trials: tuple[TrialRow, ...] = ()

    def show_trials(self, trials: Sequence[TrialRow]) -> None:
        """Show these rollouts."""
        self.beginResetModel()
        self.trials = tuple(trials)
        self.endResetModel()

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return one row per rollout."""
        return 0 if parent.isValid() else len(self.trials)

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return the number of columns."""
        return 0 if parent.isValid() else len(_TITLES)

    def data(self, index: QModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return the text of a cell, its sort value, its sign or its tooltip."""
        if not index.isValid():
            return None
        trial, column = self.trials[index.row()], index.column()
        number = _get_number(trial, column)
        if role == SORT_ROLE:
            return format_cell(trial, column) if number is None else number if math.isfinite(number) else -math.inf
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return _RIGHT if number is not None else None
        values = {
            Qt.ItemDataRole.DisplayRole: lambda: format_cell(trial, column),
            Qt.ItemDataRole.DecorationRole: lambda: (
                make_state_icon(_ICONS[trial.outcome]) if column == OUTCOME else None
            ),
            Qt.ItemDataRole.ToolTipRole: lambda: trial.problem or f"{trial.path.name}: {format_cell(trial, CAUSE)}",
        }
        value = values.get(Qt.ItemDataRole(role))
        return None if value is None else value()

    def headerData(  # noqa: N802
        self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole
    ) -> object:
        """Return title or tooltip of a column."""
        if orientation != Qt.Orientation.Horizontal or not 0 <= section < len(_TITLES):
            return None
        texts = {Qt.ItemDataRole.DisplayRole: _TITLES, Qt.ItemDataRole.ToolTipRole: _TIPS}
        return texts[Qt.ItemDataRole(role)][section] if role in texts else None


def format_cell(trial: TrialRow, column: int) -> str:
    """Return the text of a cell."""
    if trial.problem:
        return {CASE: trial.path.name, OUTCOME: trial.outcome, CAUSE: trial.problem}.get(column, "")
    number = _get_number(trial, column)
    if number is not None:
        digits = {TRIAL: "d", TOLERANCE: "g", ERROR_MM: ".2f", ERROR_DEG: ".1f"}[column]
        return format(int(number) if column == TRIAL else number, digits) if math.isfinite(number) else "-"
    cause = ": ".join(filter(None, (trial.cause, trial.share)))
    return {TASK: trial.task, CASE: trial.case, TOUCH: trial.touch, OUTCOME: trial.outcome, CAUSE: cause}[column]


def _get_number(trial: TrialRow, column: int) -> float | None:
    """Return the number of a cell; None for a column of texts."""
    numbers = {
        TRIAL: float(trial.trial), TOLERANCE: trial.tolerance_mm, ERROR_MM: trial.error_mm, ERROR_DEG: trial.error_deg,
    }  # fmt: skip
    return numbers.get(column)


def matches_term(model: TrialsModel, row: int, word: str) -> bool:
    """Return whether a filter term holds for a rollout: a limit of the error in mm, or a word of any cell."""
    trial = model.trials[row]
    is_within = matches_limit(word, trial.error_mm)
    if is_within is not None:
        return is_within
    return any(word in format_cell(trial, column).lower() for column in range(len(_TITLES)))
