"""The page that tries two parameters against each other: what to try, the grid that fills, time against error."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QComboBox,
    QGridLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from widgets.styling import set_spacing
from widgets.sweep_grid import SweepGrid, SweepPlot, SweepTrial

_HINT = "choose two parameters and their values, then press Sweep; a click on a cell uses its values"


class SweepPage(QWidget):
    """`axis_chosen(which)`, `sweep_wanted`, `cancel_wanted` and `cell_chosen(row, col)`; knows nothing of methods."""

    axis_chosen = pyqtSignal(int)  # 0 across, 1 down
    sweep_requested = pyqtSignal()
    cancel_requested = pyqtSignal()
    cell_chosen = pyqtSignal(int, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.axes, self.values = (QComboBox(), QComboBox()), (QLineEdit(), QLineEdit())
        self.metric_box, self.start_button, self.bar = QComboBox(), QPushButton("Sweep"), QProgressBar()
        self.grid, self.plot, self.message = SweepGrid(), SweepPlot(), QLabel(_HINT)
        self._busy = False
        head = set_spacing(QGridLayout(), 6)
        for which, word in enumerate(("columns", "rows")):
            box, line = self.axes[which], self.values[which]
            box.setObjectName(f"sweep_{word}")
            line.setObjectName(f"sweep_{word}_values")
            box.setAccessibleName(f"parameter of the {word}")
            line.setAccessibleName(f"values of the {word}")
            line.setToolTip("Values, with commas between them")
            box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
            box.activated.connect(partial(self._choose, which))
            line.returnPressed.connect(self.sweep_requested)
            head.addWidget(QLabel(word), which, 0)
            head.addWidget(box, which, 1)
            head.addWidget(line, which, 2)
        self.metric_box.setObjectName("sweep_figure")
        self.metric_box.setAccessibleName("figure that judges")
        self.start_button.setObjectName("sweep_go")
        self.bar.setTextVisible(False)
        self.bar.setRange(0, 1000)
        self.bar.hide()
        head.addWidget(QLabel("judged by"), 0, 3)
        head.addWidget(self.metric_box, 0, 4)
        head.addWidget(self.start_button, 1, 3)
        head.addWidget(self.bar, 1, 4)
        head.setColumnStretch(2, 1)
        self.message.setWordWrap(True)
        self.message.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        both = QSplitter(Qt.Orientation.Horizontal)
        for widget, share in ((self.grid, 3), (self.plot, 2)):
            both.addWidget(widget)
            both.setStretchFactor(both.count() - 1, share)
        layout = set_spacing(QVBoxLayout(self), 6, (8, 6, 8, 2))
        layout.addLayout(head)
        layout.addWidget(self.message)
        layout.addWidget(both, 1)
        self.start_button.clicked.connect(self._start_or_stop)
        for one, other in ((self.grid, self.plot), (self.plot, self.grid)):
            one.cell_hovered.connect(one.mark_cell)
            one.cell_hovered.connect(other.mark_cell)
            one.cell_chosen.connect(self.cell_chosen)

    def _choose(self, which: int, _: int) -> None:
        self.axis_chosen.emit(which)

    def _start_or_stop(self) -> None:
        signal = self.cancel_requested if self._busy else self.sweep_requested
        signal.emit()

    def offer_parameters(
        self, words: Sequence[str], chosen: tuple[int, int], figures: Sequence[str], figure: str
    ) -> None:
        """The parameters to choose from, which two are, and the figures; says nothing to anybody."""
        for box, index in zip(self.axes, chosen, strict=True):
            with QSignalBlocker(box):
                if [box.itemText(i) for i in range(box.count())] != list(words):
                    box.clear()
                    box.addItems(list(words))
                box.setCurrentIndex(index)
        with QSignalBlocker(self.metric_box):
            if [self.metric_box.itemText(i) for i in range(self.metric_box.count())] != list(figures):
                self.metric_box.clear()
                self.metric_box.addItems(list(figures))
            self.metric_box.setCurrentText(figure)

    def show_values(self, which: int, values: Sequence[object]) -> None:
        """The values to try along an axis."""
        self.values[which].setText(", ".join(f"{v:g}" if isinstance(v, float) else str(v).lower() for v in values))

    def show_empty(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """An empty grid."""
        for one in (self.grid, self.plot):
            one.used_cell = (-1, -1)
        self.grid.show_axes(across, down, unit)
        self.plot.show_trials({}, unit)

    def show_cell(self, row: int, col: int, tried: SweepTrial) -> None:
        """One more is known."""
        self.grid.show_cell(row, col, tried)
        self.plot.show_trials(self.grid.trials, self.grid.unit)

    def mark_used_cell(self, row: int, col: int) -> None:
        """Whose values the window works with."""
        for one in (self.grid, self.plot):
            one.used_cell = (row, col)
            one.update()

    def show_progress(self, fraction: float | None, message: str = "") -> None:
        """How far it is, None when it rests."""
        self._busy = fraction is not None
        self.start_button.setText("Cancel" if self._busy else "Sweep")
        self.bar.setVisible(self._busy)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))
        self.message.setText(message or _HINT)
