"""Table model of the frames: what is known of each, sortable by any metric."""

import math
from collections.abc import Mapping

from PyQt6.QtCore import QAbstractTableModel, QModelIndex, QObject, Qt, pyqtSignal
from PyQt6.QtGui import QGuiApplication, QIcon, QPixmap

from widgets.frames.frame_summary import FrameSummary
from widgets.style.icons import make_state_icon
from widgets.style.tables import RIGHT, SORT_ROLE, get_sort_key
from widgets.style.theme import is_dark
from widgets.views.preview_renderer import make_qimage

_Role = Qt.ItemDataRole
FRAME, METRIC, CAUSE, DEPTH, CONTACT, WARNINGS, NOTE = range(7)
_TITLES = ("frame", "error", "cause", "depth\nmm", "area\nmm²", "warn", "note")
_TIPS = (
    "frame number, with an image of the source",
    "",
    "the stage that most of the error comes from, by the truth; without truth the stage of its "
    "first warning",
    "largest indentation of the source sensor, mm",
    "contact area on the source sensor, mm²",
    "number of warnings that not every frame has",
    "your note on the frame",
)
_DECIMALS = {FRAME: 0, METRIC: 3, DEPTH: 2, CONTACT: 1, WARNINGS: 0}
_N_WARNINGS = "frame.n_warnings"


class FramesModel(QAbstractTableModel):
    """Frame numbers, summaries and notes; a frame that nobody looked at costs nothing.

    Emits `noted(frame, text)` when a note is written.
    """

    note_edited = pyqtSignal(int, str)

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self.n_rows = 0
        self._headings: dict[int, list[str]] = {
            _Role.DisplayRole: [*_TITLES],
            _Role.ToolTipRole: [*_TIPS],
        }
        self._figure = ""  # of the metric's column
        self._known: dict[int, FrameSummary] = {}
        # measured on request, also of frames without summary
        self._quantities: dict[int, Mapping[str, float]] = {}
        self._notes: Mapping[int, str] = {}
        self._common: frozenset[str] | None = None  # None = not computed yet
        self._thumbnails: dict[int, tuple[QPixmap, QPixmap]] = {}  # in the light and the dark theme

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return the number of rows."""
        return 0 if parent.isValid() else self.n_rows

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: N802, B008 - Qt's own default
        """Return the number of columns."""
        return 0 if parent.isValid() else len(_TITLES)

    def headerData(  # noqa: N802 - Qt's name
        self, section: int, orientation: Qt.Orientation, role: int = _Role.DisplayRole
    ) -> object:
        """Return title or tooltip of a column."""
        is_column = orientation == Qt.Orientation.Horizontal and 0 <= section < len(_TITLES)
        return self._headings[role][section] if is_column and role in self._headings else None

    @property
    def metrics(self) -> tuple[str, ...]:
        """All metrics of the known frames, in order of first appearance."""
        return tuple(
            dict.fromkeys(name for known in self._known.values() for name in known.metrics)
        )

    def get_summary(self, frame: int) -> FrameSummary | None:
        """Return the summary of a frame; None if unknown."""
        return self._known.get(frame)

    def find_unknown_frame(
        self, frame: int, *, completely: bool = False, quantity: str = ""
    ) -> int:
        """Return the frame closest to `frame` that is not known, later ones first; -1 when all are.

        `completely` looks for frames that lack what takes another translation, `quantity` for those
        where it was not measured.
        """
        if completely:
            waiting = [i for i, known in self._known.items() if not known.is_complete]
        else:
            measured = {i for i, values in self._quantities.items() if quantity in values}
            known = measured if quantity else self._known.keys()
            waiting = [i for i in range(self.n_rows) if i not in known]
        return min(waiting, key=lambda i: (abs(i - frame), -i), default=-1)

    @property
    def common_warnings(self) -> frozenset[str]:
        """Return the warnings that all known frames with contact share."""
        if self._common is None:
            warnings = [
                set(known.warnings) for known in self._known.values() if known.contact_area_mm2 > 0
            ]
            shared = set[str]() if len(warnings) < 2 else set.intersection(*warnings)
            self._common = frozenset(shared)
        return self._common

    def get_specific_warnings(self, frame: int) -> tuple[str, ...]:
        """Return the warnings of a frame that are not common to all frames."""
        known = self._known.get(frame, FrameSummary())
        return tuple(one for one in known.warnings if one not in self.common_warnings)

    def get_values(self, figure: str) -> tuple[float, ...]:
        """Return a metric of every frame, NaN where unknown."""
        return tuple(self._get_metric(i, figure) for i in range(self.n_rows))

    def _get_metric(self, frame: int, figure: str) -> float:
        if (quantity := self._quantities.get(frame, {}).get(figure)) is not None:
            return quantity
        known = self._known.get(frame)
        if known is None or known.problem:
            return math.nan
        if figure == _N_WARNINGS:
            return float(len(self.get_specific_warnings(frame)))
        return known.get_metric(figure)

    @property
    def thumbnails(self) -> dict[int, QPixmap]:
        """Frame -> image of the source in the current theme, where it is known."""
        theme = is_dark(QGuiApplication.palette())
        return {frame: both[theme] for frame, both in self._thumbnails.items()}

    def reset_frames(self, n_frames: int) -> None:
        """Start over with this many unknown frames."""
        self.beginResetModel()
        self.n_rows = n_frames
        self._known = {}
        self._quantities = {}
        self._common = None
        self._thumbnails = {}
        self.endResetModel()

    def grow_to(self, n_frames: int) -> None:
        """Add rows for new frames."""
        if n_frames > self.n_rows:
            self.beginInsertRows(QModelIndex(), self.n_rows, n_frames - 1)
            self.n_rows = n_frames
            self.endInsertRows()

    def clear_summaries(self) -> None:
        """Clear all summaries and quantities, because the settings changed."""
        self._known, self._quantities, self._common = {}, {}, None
        self._emit_changed(0, self.n_rows - 1)

    def show_metric(self, name: str, title: str, tip: str = "") -> None:
        """Set the metric, title and tooltip of the metric's column."""
        titles, tips = self._headings.values()
        if (name, title) != (self._figure, titles[METRIC]):
            self._figure = name
            titles[METRIC] = title
            tips[METRIC] = f"{tip}; - where unknown"
            self.headerDataChanged.emit(Qt.Orientation.Horizontal, METRIC, METRIC)
            self._emit_changed(0, self.n_rows - 1)

    def show_summary(self, frame: int, summary: FrameSummary) -> None:
        """Fill one row."""
        old = self._known.get(frame)
        if old is summary or not 0 <= frame < self.n_rows:
            return
        if summary.thumbnail is not None and frame not in self._thumbnails:
            dark = summary.thumbnail if summary.dark_thumbnail is None else summary.dark_thumbnail
            self._thumbnails[frame] = (
                QPixmap.fromImage(make_qimage(summary.thumbnail)),
                QPixmap.fromImage(make_qimage(dark)),
            )
        self._known[frame] = summary if old is None else old.merge(summary)
        self._common = None
        self._emit_changed(frame, frame)

    def show_quantities(self, frame: int, quantities: Mapping[str, float]) -> None:
        """Add what was measured of a frame on request: metric -> value, NaN where it could not
        be.
        """
        if 0 <= frame < self.n_rows:
            self._quantities[frame] = {**self._quantities.get(frame, {}), **quantities}
            self._emit_changed(frame, frame)

    def show_notes(self, notes: Mapping[int, str]) -> None:
        """Show the notes of frames."""
        if notes != self._notes:
            self._notes = notes
            if self.n_rows:
                self.dataChanged.emit(self.index(0, NOTE), self.index(self.n_rows - 1, NOTE))

    def get_note(self, frame: int) -> str:
        """Return the note of a frame."""
        return self._notes.get(frame, "")

    def flags(self, index: QModelIndex) -> Qt.ItemFlag:
        """Make the note column editable."""
        usual = super().flags(index)
        return usual | Qt.ItemFlag.ItemIsEditable if index.column() == NOTE else usual

    def setData(  # noqa: N802 - Qt's name
        self, index: QModelIndex, value: object, role: int = Qt.ItemDataRole.EditRole
    ) -> bool:
        """Emit an edited note; its owner stores and shows it."""
        is_edit = index.isValid() and index.column() == NOTE and role == _Role.EditRole
        if is_edit:
            self.note_edited.emit(index.row(), str(value).strip())
        return is_edit

    def data(self, index: QModelIndex, role: int = _Role.DisplayRole) -> object:
        """Return what Qt asks of a cell; numbers are sorted as such and stand at the right."""
        if not index.isValid():
            return None
        row, column = index.row(), index.column()
        number = self.get_number(row, column)
        if role == SORT_ROLE and number is not None:
            return get_sort_key(number)
        if role == _Role.TextAlignmentRole:
            return None if number is None else RIGHT
        if role == _Role.EditRole:
            return self.get_note(row) if column == NOTE else None
        reads = {
            _Role.DisplayRole: self.format_cell,
            SORT_ROLE: self.format_cell,
            _Role.DecorationRole: self.get_picture,
            _Role.ToolTipRole: self.get_tip,
        }
        return reads[_Role(role)](row, column) if role in reads else None

    def get_picture(self, row: int, column: int) -> object:
        """Return the image of a frame, or the sign next to its number of warnings."""
        both = self._thumbnails.get(row) if column == FRAME else None
        if both is not None:
            return QIcon(both[is_dark(QGuiApplication.palette())])
        warns = column == WARNINGS and bool(self.get_specific_warnings(row))
        return make_state_icon("warning") if warns else None

    def get_tip(self, row: int, column: int) -> str:
        """Return why a frame failed, or its warnings; of a note, itself."""
        summary = self._known.get(row)
        if column == NOTE or summary is None:
            return self.get_note(row) if column == NOTE else ""
        return summary.problem or "\n".join(summary.warnings)

    def get_number(self, row: int, column: int) -> float | None:
        """Return the number of a cell, NaN if unknown; None for a column of texts."""
        figures = {
            CONTACT: "",
            METRIC: self._figure,
            DEPTH: "frame.max_indentation_mm",
            WARNINGS: _N_WARNINGS,
        }
        if column == FRAME:
            return float(row)
        summary = self._known.get(row)
        if column == CONTACT and summary is not None and not summary.problem:
            return summary.contact_area_mm2
        return self._get_metric(row, figures[column]) if column in figures else None

    def format_cell(self, row: int, column: int) -> str:
        """Return the text of a cell."""
        summary = self._known.get(row)
        number = self.get_number(row, column)
        has_failed = summary is not None and bool(summary.problem)
        if column == NOTE:
            return self.get_note(row)
        if number is None:
            return "" if summary is None or has_failed else summary.cause
        if has_failed and column != FRAME:
            return "failed" if column == METRIC else ""
        unknown = "" if summary is None else "-"
        return f"{number:.{_DECIMALS[column]}f}" if math.isfinite(number) else unknown

    def _emit_changed(self, first: int, last: int) -> None:
        if last >= first:
            self.dataChanged.emit(self.index(first, FRAME), self.index(last, WARNINGS))
