"""Time budget of a frame: a sentence, a bar, and a table of the stages in which each can be skipped."""

from dataclasses import dataclass

from PyQt6.QtCore import QRectF, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QPainter, QPalette, QPen
from PyQt6.QtWidgets import (
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QSpinBox,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from widgets.base import FIXED, FixedSizeLabel, PaintedWidget
from widgets.icons import make_state_icon
from widgets.styling import fill, make_bold, set_spacing
from widgets.tables import prepare_table
from widgets.theme import CATEGORY_COLOURS, ThemeColours, to_qcolor

_BAR_PX, _MARK_PX = 18, 3
_LIGHT_LUMA = 140.0  # of 255: colours above it carry dark text


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetPart:
    """One segment of the bar."""

    title: str
    time_ms: float


class TimeBudgetBar(PaintedWidget):
    """Paints the parts of a frame's time one after the other; the mark is where the target rate ends."""

    preferred_px = 420, _BAR_PX + 2 * _MARK_PX

    def __init__(self) -> None:
        super().__init__("time_budget", "time budget of a frame", down=FIXED)
        self.parts: tuple[BudgetPart, ...] = ()
        self._target_ms = 0.0

    def show_parts(self, parts: tuple[BudgetPart, ...], target_ms: float) -> None:
        """Show these times, and the time that a frame has at the target rate."""
        self.parts, self._target_ms = parts, target_ms
        spoken = ", ".join(f"{part.title} {part.time_ms:.1f} ms" for part in parts)
        self.setToolTip(f"{spoken}; the mark is the target of {target_ms:.0f} ms" if parts else "")
        self.setAccessibleDescription(self.toolTip())
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint the segments with their titles where there is room, then the mark."""
        del ink
        longest_ms = max(sum(part.time_ms for part in self.parts), self._target_ms)
        if not self.parts or longest_ms <= 0:
            return
        per_ms, left = (self.width() - 2) / longest_ms, 0.0
        for number, part in enumerate(self.parts):
            colour = to_qcolor(CATEGORY_COLOURS[number % len(CATEGORY_COLOURS)])
            box = QRectF(left, _MARK_PX, part.time_ms * per_ms, _BAR_PX)
            painter.fillRect(box, colour)
            if painter.fontMetrics().horizontalAdvance(part.title) + 8 < box.width():
                painter.setPen(_text_colour(colour))
                painter.drawText(box, Qt.AlignmentFlag.AlignCenter, part.title)
            left = box.right()
        painter.setPen(QPen(self.palette().color(QPalette.ColorRole.WindowText), 2))
        at = round(self._target_ms * per_ms)
        painter.drawLine(at, 0, at, self.height())


def _text_colour(background: QColor) -> QColor:
    luma = 0.299 * background.red() + 0.587 * background.green() + 0.114 * background.blue()
    return QColor(20, 24, 30) if luma > _LIGHT_LUMA else QColor(255, 255, 255)


_HEADER = ("stage", "state", "this frame, ms", "median, ms", "share", "notes")
_NAME_ROLE = Qt.ItemDataRole.UserRole
_STATE, _NUMBERS = 1, (2, 3, 4)  # columns
_TARGET_HZ, _MOST_HZ = 10, 120


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingRow:
    """One stage of one frame."""

    name: str
    title: str
    state: str
    time_ms: float | None = None  # None where the stage is skipped by the user
    median_ms: float | None = None  # of recent frames in which it was computed; None before the first
    share: float = 0.0  # of the frame's time
    notes: tuple[str, ...] = ()


class TimingsPanel(QWidget):
    """Sentence and target rate over the bar over the table; unticking a stage skips it.

    `stage_toggled(name, on)` asks for a stage or for its skip, `skip_requested` for the skip that the button names.
    """

    stage_toggled = pyqtSignal(str, bool)
    skip_requested = pyqtSignal()
    target_changed = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self.sentence, self.bar, self.table = FixedSizeLabel(), TimeBudgetBar(), QTableWidget(0, len(_HEADER))
        make_bold(self.sentence)
        self._target = QSpinBox()
        self._target.setObjectName("target_rate")
        self._target.setRange(1, _MOST_HZ)
        self._target.setValue(_TARGET_HZ)
        self._target.setSuffix(" frames/s")
        self._target.setAccessibleName("target rate")
        self._target.setToolTip("Rate at which you want to play")
        self._target.valueChanged.connect(self.target_changed)
        self.skip_button = QPushButton()
        self.skip_button.setObjectName("skip_stages")
        self.skip_button.setAccessibleName("skip stages")
        self.skip_button.clicked.connect(self.skip_requested)
        self.skip_button.hide()
        head = set_spacing(QHBoxLayout(), 8)
        fill(head, (self.sentence, 1), self.skip_button, QLabel("target"), self._target)
        fill(set_spacing(QVBoxLayout(self), 3, (6, 3, 6, 2)), head, self.bar, (self.table, 1))
        self._prepare_table()

    def _prepare_table(self) -> None:
        table = self.table
        columns = prepare_table(table, "timings", "times of the stages")
        table.setHorizontalHeaderLabels(_HEADER)
        table.itemChanged.connect(self._report_tick)
        columns.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        for column, widest in enumerate(
            ("     Target depth and mask ", "    unchanged  ", "this frame, ms ", "median, ms  ", "100 %  ")
        ):
            table.setColumnWidth(column, table.fontMetrics().horizontalAdvance(widest) + 16)
        columns.setStretchLastSection(True)

    @property
    def target_hz(self) -> float:
        """The rate that the user wants to play at."""
        return float(self._target.value())

    def show_budget(self, sentence: str, parts: tuple[BudgetPart, ...], offer: str) -> None:
        """Show a sentence, the bar, and what the button offers to skip ("" = nothing)."""
        self.sentence.setText(sentence)
        self.sentence.setToolTip(sentence)
        self.bar.show_parts(parts, 1e3 / self.target_hz)
        self.skip_button.setText(offer)
        self.skip_button.setVisible(bool(offer))

    def show_rows(self, timings: tuple[TimingRow, ...], *, can_skip: bool = False) -> None:
        """Show these stages and their sum; only changed cells are updated."""
        with QSignalBlocker(self.table):
            self.table.setRowCount(len(timings) + 1)
            for at, row in enumerate(timings):
                times = "" if row.time_ms is None else f"{row.time_ms:.2f}", _format_ms(row.median_ms)
                share = "" if row.median_ms is None else f"{100 * row.share:.0f} %"
                self._cells(at, (row.title, row.state, *times, share, " · ".join(row.notes)), row.state)
                item = self.table.item(at, 0)
                assert item is not None
                item.setData(_NAME_ROLE, row.name)
                item.setFlags(
                    Qt.ItemFlag.ItemIsSelectable
                    | Qt.ItemFlag.ItemIsEnabled
                    | (Qt.ItemFlag.ItemIsUserCheckable if can_skip else Qt.ItemFlag.NoItemFlags)
                )
                item.setCheckState(Qt.CheckState.Unchecked if row.time_ms is None else Qt.CheckState.Checked)
                item.setToolTip("Untick to skip this stage and all that need it" if can_skip else row.title)
            medians = [row.median_ms for row in timings if row.median_ms is not None and row.time_ms is not None]
            spent = f"{sum(row.time_ms or 0.0 for row in timings):.2f}"
            total = _format_ms(sum(medians) if medians else None)
            self._cells(len(timings), ("all stages", "", spent, total, "", ""), "")
            last = self.table.item(len(timings), 0)
            assert last is not None
            for role in (Qt.ItemDataRole.CheckStateRole, _NAME_ROLE):
                last.setData(role, None)

    def _cells(self, at: int, texts: tuple[str, ...], state: str) -> None:
        for column, text in enumerate(texts):
            item = self.table.item(at, column)
            if item is None:
                item = QTableWidgetItem()
                if column in _NUMBERS:
                    item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.table.setItem(at, column, item)
            if item.text() != text:
                item.setText(text)
                item.setToolTip(text)
                if column == _STATE:
                    item.setData(Qt.ItemDataRole.DecorationRole, make_state_icon(state) if state else None)

    def _report_tick(self, item: QTableWidgetItem) -> None:
        name = item.data(_NAME_ROLE)
        if item.column() == 0 and name:
            self.stage_toggled.emit(name, item.checkState() == Qt.CheckState.Checked)


def _format_ms(time_ms: float | None) -> str:
    return "" if time_ms is None else f"{time_ms:.2f}"
