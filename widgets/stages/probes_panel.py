"""The probe: the trace of one pixel through the stages, and the table of the pinned pixels."""

from collections.abc import Sequence
from html import escape

from PyQt6.QtCore import QEvent, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QIcon, QPixmap
from PyQt6.QtWidgets import (
    QFrame,
    QHeaderView,
    QLabel,
    QPushButton,
    QScrollArea,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from pipeline.core.frozen import frozen
from widgets.style.base import EventListener
from widgets.style.styling import make_column, make_row, make_text, name_widget
from widgets.style.tables import prepare_table
from widgets.style.theme import get_probe_colour, get_theme_colours, to_hex, to_qcolor

_HINT = "A click on an image pins a pixel, up to five; a click on its mark releases it."
_ICON_PX = 10
_INVITATION = (
    "Move the mouse over an image to follow that pixel through every stage. "
    "A click pins it; <b>Esc</b> clears all."
)


class TracePanel(QScrollArea):
    """Shows a pixel trace, one titled step after the other."""

    def __init__(self) -> None:
        super().__init__()
        name_widget(self, "trace", "trace of the pixel")
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self._label = make_text(rich=True, selectable=True)
        self._label.setAlignment(Qt.AlignmentFlag.AlignTop)
        self._label.setContentsMargins(6, 1, 6, 1)
        self.setWidget(self._label)
        self.setFixedHeight(self.fontMetrics().lineSpacing() + 3)  # more lines scroll
        self.text = ""
        self._shown: tuple[Sequence[tuple[str, str]], bool, str, bool] = ((), False, "", False)
        EventListener(self, self._show, QEvent.Type.PaletteChange)
        self._show()

    def show_steps(
        self,
        steps: Sequence[tuple[str, str]],
        *,
        pinned: bool = False,
        ending: str = "",
        is_waiting: bool = False,
    ) -> None:
        """Show (stage title, text) pairs in order, and why the trace ends.

        In plain colour while `is_waiting`.
        """
        self._shown = steps, pinned, ending, is_waiting
        self.text = " → ".join(text for _, text in steps)
        self._show()

    def _show(self) -> None:
        steps, pinned, ending, is_waiting = self._shown
        ink = get_theme_colours(self.palette())
        soft = to_hex(ink.secondary_text)
        alarm = to_hex(ink.warning_text)
        parts = [
            f"<span style='color:{soft}'>{escape(title)}</span> <b>{escape(text)}</b>"
            for title, text in steps
        ]
        sentence = " &nbsp;→&nbsp; ".join(parts)
        if ending and steps:
            sentence += (
                " &nbsp; <span "
                f"style='color:{soft if is_waiting else alarm}'>{escape(ending)}</span>"
            )
        sentence += " &nbsp; <i>pinned</i>" if pinned and steps else ""
        self._label.setText(sentence or _INVITATION)


@frozen
class ProbeRow:
    """One pinned pixel."""

    number: int
    cells: tuple[str, ...]  # as the titles
    tips: tuple[str, ...]  # one per cell


class ProbesPanel(QWidget):
    """Shows one row per pinned pixel; `probe_chosen` carries the number of the selected row."""

    probe_chosen = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__()
        self.table = QTableWidget(0, 0)
        self.clear_button = QPushButton("Release all")
        columns = prepare_table(self.table, "probes", "pinned pixels")
        columns.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.table.cellClicked.connect(self._choose)
        self._numbers: tuple[int, ...] = ()
        self.clear_button.setEnabled(False)
        head = make_row(8, (QLabel(_HINT), 1), self.clear_button)
        make_column(3, head, (self.table, 1), around_px=(6, 3, 6, 2), on=self)

    def _choose(self, row: int, _: int) -> None:
        self.probe_chosen.emit(self._numbers[row])

    def show_probes(self, titles: Sequence[str], rows: Sequence[ProbeRow]) -> None:
        """Show these pinned pixels under these titles."""
        self._numbers = tuple(row.number for row in rows)
        self.clear_button.setEnabled(bool(rows))
        with QSignalBlocker(self.table):
            self.table.setColumnCount(len(titles))
            self.table.setHorizontalHeaderLabels(titles)
            self.table.setRowCount(len(rows))
            for at, row in enumerate(rows):
                for column, (text, tip) in enumerate(zip(row.cells, row.tips, strict=True)):
                    item = QTableWidgetItem(text)
                    item.setToolTip(tip)
                    if column == 0:
                        item.setIcon(_make_icon(row.number))
                    self.table.setItem(at, column, item)


def _make_icon(number: int) -> QIcon:
    pixmap = QPixmap(_ICON_PX, _ICON_PX)
    pixmap.fill(to_qcolor(get_probe_colour(number)))
    return QIcon(pixmap)
