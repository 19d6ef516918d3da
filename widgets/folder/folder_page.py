"""Page of the *Folder* layout: the recordings of a folder as one table."""

import math
from collections.abc import Sequence
from pathlib import Path

from PyQt6.QtCore import QModelIndex, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QIcon, QPixmap, QStandardItem
from PyQt6.QtWidgets import QHeaderView, QWidget

from pipeline.core.errors import escape_text, name_options
from pipeline.translation.reports.folder_overview import THUMBNAIL_PX, RecordingRow, WorstFrame
from widgets.style.icons import make_state_icon
from widgets.style.run_bar import StartBar
from widgets.style.styling import (
    make_bold,
    make_column,
    make_command_button,
    make_row,
    make_text,
)
from widgets.style.tables import FilteredTable, Terms, make_cells, make_titled_model
from widgets.views.preview_renderer import make_qimage

_FILTER = (
    "filter: touched, warned, unreadable, gelslim, >0.3, a word\n"
    "Recordings that match all terms: touched, warned, unreadable, a limit of the worst error in "
    "mm, or a word of a name, a sensor or a warning"
)
_PURPOSE = (
    "Open a folder of recordings to see which of them have contact, what is wrong with each, and "
    "where its error is largest."
)
TOUCH, NAME, _, FRAMES, CONTACT, *_, WARNINGS = range(8)
_COLUMNS = (
    ("first touch", "the first frame with contact, of up to 24 that are looked at", ".0f"),
    ("recording", "file or folder; Enter opens it", ""),
    ("sensors", "sensors that the recording names", ""),
    ("frames", "number of frames", ".0f"),
    ("contact", "share of the frames with contact, of up to 24 that are looked at", ".0%"),
    (
        "worst",
        "the frame with the largest error against the recorded touch; Find worst frames computes "
        "it",
        ".0f",
    ),
    ("error, mm", "error of that frame's generated touch in contact, mm", ".3f"),
    ("warnings", "what the inspection finds wrong", ""),
)


def _make_row(path: Path, row: RecordingRow | None, worst: WorstFrame) -> list[QStandardItem]:
    """Return the cells of a recording; what is not known is empty."""
    known = row or RecordingRow()
    problem = known.problem or known.warnings
    more = f" (and {known.n_warnings - 1} more)" if known.n_warnings > 1 else ""
    is_known = row is not None and not row.problem
    values = (
        known.first_touch if known.first_touch >= 0 else math.nan,
        escape_text(path.name),
        known.sensors,
        known.n_frames if is_known else math.nan,
        known.contact_share if is_known else math.nan,
        worst.frame if worst.frame >= 0 else math.nan,
        worst.error_mm,
        name_options(problem.partition("\n")[0]) + more,
    )
    cells = make_cells(_COLUMNS, values, name_options(escape_text(problem or str(path))))
    if problem:
        cells[WARNINGS].setIcon(make_state_icon("failed" if known.problem else "warning"))
    if known.thumbnail.size:
        image = QPixmap.fromImage(make_qimage(known.thumbnail))
        cells[TOUCH].setIcon(QIcon(image))
    return cells


class FolderPage(QWidget):
    """Filter and start of the ranking over the table; `recording_chosen` carries a path."""

    recording_chosen = pyqtSignal(Path)

    def __init__(self, open_command: QAction) -> None:
        super().__init__()
        self.model = make_titled_model(_COLUMNS, self)
        self.paths: tuple[Path, ...] = ()
        self.rows: dict[Path, RecordingRow] = {}
        self.worst: dict[Path, WorstFrame] = {}
        self.table = FilteredTable("recordings", self.model, self._get_terms, _FILTER)
        self.run_bar = StartBar("folder", "Find worst frames")
        self.run_bar.start_button.setToolTip(
            "Compute every frame of the recordings that hold the target's touch, and show the "
            "worst of each"
        )
        self.sentence = make_bold(make_text())
        self.table.setIconSize(QSize(*THUMBNAIL_PX))
        self.table.set_row_height(THUMBNAIL_PX[1] + 4)
        self.table.columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.columns.setSectionResizeMode(WARNINGS, QHeaderView.ResizeMode.Stretch)
        self.table.sort_from(NAME)
        self.table.activated.connect(self._choose)  # Enter, or a double click
        opener = make_command_button(open_command)
        opener.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        head = make_row(8, (self.sentence, 1), self.run_bar, opener)
        make_column(
            4, head, self.table.filter_line, (self.table, 1), around_px=(8, 4, 8, 4), on=self
        )
        self.show_count(None)

    def show_paths(self, folder: Path, paths: Sequence[Path]) -> None:
        """Show the recordings of a folder, of which nothing is known."""
        self.paths = tuple(paths)
        self.rows, self.worst = {}, {}
        self.model.setRowCount(0)
        for path in paths:
            self.model.appendRow(_make_row(path, None, WorstFrame()))
        self.show_count(folder)
        if paths:
            self.table.setCurrentIndex(self.table.listed.index(0, NAME))

    def show_part(self, path: Path, part: RecordingRow | WorstFrame) -> None:
        """Fill the row of a recording, or its worst frame."""
        if path not in self.paths:
            return
        if isinstance(part, WorstFrame):
            self.worst[path] = part
        else:
            self.rows[path] = part
        cells = _make_row(path, self.rows.get(path), self.worst.get(path, WorstFrame()))
        for column, cell in enumerate(cells):
            self.model.setItem(self.paths.index(path), column, cell)

    def show_count(self, folder: Path | None) -> None:
        """Say how many recordings there are, and how many are known."""
        known, of = len(self.rows), len(self.paths)
        done = "" if known == of else f", {known} of {of} read"
        self.sentence.setText(
            _PURPOSE if folder is None else escape_text(f"{folder.name}: {of} recordings{done}")
        )
        for widget in (self.table.filter_line, self.table, self.run_bar):
            widget.setVisible(folder is not None)

    def _get_terms(self, at: int) -> Terms:
        """Return what terms of the filter can hold for."""
        path = self.paths[at]
        row = self.rows.get(path, RecordingRow())
        states = {
            "touched": row.contact_share > 0,
            "warned": bool(row.warnings),
            "unreadable": bool(row.problem),
        }
        texts = (path.name, row.sensors, row.warnings, row.problem)
        return self.worst.get(path, WorstFrame()).error_mm, states, texts

    def _choose(self, index: QModelIndex) -> None:
        self.recording_chosen.emit(self.paths[self.table.find_row(index)])
