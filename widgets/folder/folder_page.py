"""Page of the *Folder* layout: the recordings of a folder as one table."""

import math
from collections.abc import Sequence
from pathlib import Path

from PyQt6.QtCore import QModelIndex, QObject, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QIcon, QImage, QPixmap
from PyQt6.QtWidgets import QHBoxLayout, QHeaderView, QLabel, QTableView, QVBoxLayout, QWidget

from pipeline.core.errors import escape_text, name_options
from pipeline.translation.reports.folder_overview import THUMBNAIL_PX, RecordingRow, WorstFrame
from widgets.style.icons import make_state_icon
from widgets.style.run_bar import StartBar
from widgets.style.styling import (
    fill,
    make_bold,
    make_command_button,
    make_search_line,
    set_spacing,
)
from widgets.style.tables import RowFilter, RowsModel, matches_limit, prepare_table

_HINT = "filter: touched, warned, unreadable, gelslim, >0.3, a word"
_FILTER_TIP = (
    "Recordings that match all terms: touched, warned, unreadable, a limit of the worst error in "
    "mm, or a word of a name, a sensor or a warning"
)
_PURPOSE = (
    "Open a folder of recordings to see which of them have contact, what is wrong with each, and "
    "where its error is largest."
)
TOUCH, NAME, SENSORS, FRAMES, CONTACT, WORST, ERROR, WARNINGS = range(8)
_TITLES = (
    "first touch",
    "recording",
    "sensors",
    "frames",
    "contact",
    "worst",
    "error, mm",
    "warnings",
)
_TIPS = (
    "the first frame with contact, of up to 24 that are looked at",
    "file or folder; Enter opens it",
    "sensors that the recording names",
    "number of frames",
    "share of the frames with contact, of up to 24 that are looked at",
    "the frame with the largest error against the recorded touch; Find worst frames computes it",
    "error of that frame's generated touch in contact, mm",
    "what the inspection finds wrong",
)
_Role = Qt.ItemDataRole


class RecordingsModel(RowsModel):
    """One row per recording; what is not known yet is empty."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(_TITLES, _TIPS, parent)
        self.paths: tuple[Path, ...] = ()
        self.rows: dict[Path, RecordingRow] = {}
        self.worst: dict[Path, WorstFrame] = {}
        self._icons: dict[Path, QIcon] = {}

    def show_paths(self, paths: Sequence[Path]) -> None:
        """Show these recordings, of which nothing is known."""
        self.beginResetModel()
        self.paths = tuple(paths)
        self.n_rows = len(paths)
        self.rows, self.worst, self._icons = {}, {}, {}
        self.endResetModel()

    def show_part(self, path: Path, part: RecordingRow | WorstFrame) -> None:
        """Fill the row of a recording, or its worst frame."""
        if path not in self.paths:
            return
        if isinstance(part, WorstFrame):
            self.worst[path] = part
        else:
            self.rows[path] = part
            self._icons[path] = _make_icon(part)
        row = self.paths.index(path)
        self.dataChanged.emit(self.index(row, 0), self.index(row, WARNINGS))

    def format_cell(self, row: int, column: int) -> str:
        """Return the text of a cell."""
        path = self.paths[row]
        known = self.rows.get(path, RecordingRow())
        number = self.get_number(row, column)
        if number is not None:
            digits = {CONTACT: ".0%", ERROR: ".3f"}.get(column, ".0f")
            is_known = path in self.rows and not known.problem and math.isfinite(number)
            return format(number, digits) if is_known else ""
        first = (known.problem or known.warnings).partition("\n")[0]
        more = f" (and {known.n_warnings - 1} more)" if known.n_warnings > 1 else ""
        return {
            NAME: escape_text(path.name),
            SENSORS: known.sensors,
            WARNINGS: name_options(first) + more,
        }[column]

    def get_number(self, row: int, column: int) -> float | None:
        """Return the number of a cell, NaN if unknown; None for a column of texts."""
        path = self.paths[row]
        known = self.rows.get(path, RecordingRow())
        worst = self.worst.get(path, WorstFrame())
        numbers = {
            TOUCH: known.first_touch if known.first_touch >= 0 else math.nan,
            FRAMES: known.n_frames,
            CONTACT: known.contact_share,
            WORST: worst.frame if worst.frame >= 0 else math.nan,
            ERROR: worst.error_mm,
        }
        return numbers.get(column)

    def get_picture(self, row: int, column: int) -> object:
        """Return the first touch, or the sign of a warning."""
        known = self.rows.get(self.paths[row], RecordingRow())
        if column == WARNINGS and (known.warnings or known.problem):
            return make_state_icon("failed" if known.problem else "warning")
        return self._icons.get(self.paths[row]) if column == TOUCH else None

    def get_tip(self, row: int, column: int) -> str:  # noqa: ARG002 - of the row
        """Return everything that is wrong with a recording, else its path."""
        known = self.rows.get(self.paths[row], RecordingRow())
        return name_options(escape_text(known.problem or known.warnings or str(self.paths[row])))

    def matches_term(self, at: int, word: str) -> bool:
        """Return whether a filter term holds for a recording."""
        path = self.paths[at]
        row = self.rows.get(path, RecordingRow())
        is_within = matches_limit(word, self.worst.get(path, WorstFrame()).error_mm)
        if is_within is not None:
            return is_within
        own = {
            "touched": row.contact_share > 0,
            "warned": bool(row.warnings),
            "unreadable": bool(row.problem),
        }
        texts = (path.name, row.sensors, row.warnings, row.problem)
        return own[word] if word in own else any(word in text.lower() for text in texts)


class FolderPage(QWidget):
    """Filter and start of the ranking over the table; `recording_chosen` carries a path."""

    recording_chosen = pyqtSignal(Path)

    def __init__(self, open_command: QAction) -> None:
        super().__init__()
        self.model = RecordingsModel(self)
        self._listed = RowFilter(self.model, self.model.matches_term)
        self.filter_line = make_search_line(
            "folder_filter", "filter of the recordings", _HINT, _FILTER_TIP
        )
        self.filter_line.textChanged.connect(self._listed.set_filter)
        self.run_bar = StartBar("folder", "Find worst frames")
        self.run_bar.start_button.setToolTip(
            "Compute every frame of the recordings that hold the target's touch, and show the "
            "worst of each"
        )
        self.sentence = QLabel(_PURPOSE)
        self.sentence.setWordWrap(True)
        make_bold(self.sentence)
        self.table = QTableView()
        columns = prepare_table(self.table, "recordings", "recordings")
        self.table.setModel(self._listed)
        self.table.setIconSize(QSize(*THUMBNAIL_PX))
        rows = self.table.verticalHeader()
        assert rows is not None
        rows.setDefaultSectionSize(THUMBNAIL_PX[1] + 4)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        columns.setSectionResizeMode(WARNINGS, QHeaderView.ResizeMode.Stretch)
        columns.setSortIndicator(NAME, Qt.SortOrder.AscendingOrder)
        self.table.setSortingEnabled(True)
        self.table.activated.connect(self._choose)  # Enter, or a double click
        opener = make_command_button(open_command)
        opener.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        head = fill(set_spacing(QHBoxLayout(), 8), (self.sentence, 1), self.run_bar, opener)
        layout = set_spacing(QVBoxLayout(self), 4, (8, 4, 8, 4))
        fill(layout, head, self.filter_line, (self.table, 1))
        self.show_count(None)

    def show_paths(self, folder: Path, paths: Sequence[Path]) -> None:
        """Show the recordings of a folder."""
        self.model.show_paths(paths)
        self.show_count(folder)
        if paths:
            self.table.setCurrentIndex(self._listed.index(0, NAME))

    def show_count(self, folder: Path | None) -> None:
        """Say how many recordings there are, and how many are known."""
        known, of = len(self.model.rows), len(self.model.paths)
        done = "" if known == of else f", {known} of {of} read"
        is_open = folder is not None
        self.sentence.setText(
            escape_text(f"{folder.name}: {of} recordings{done}") if folder is not None else _PURPOSE
        )
        for widget in (self.filter_line, self.table, self.run_bar):
            widget.setVisible(is_open)

    def _choose(self, index: QModelIndex) -> None:
        self.recording_chosen.emit(self.model.paths[self._listed.mapToSource(index).row()])


def _make_icon(row: RecordingRow) -> QIcon:
    rows, cols = row.thumbnail.shape[:2]
    if not rows:
        return QIcon()
    image = QImage(row.thumbnail.tobytes(), cols, rows, 3 * cols, QImage.Format.Format_RGB888)
    return QIcon(QPixmap.fromImage(image))
