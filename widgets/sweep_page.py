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

from widgets.looks import spaced
from widgets.sweep_grid import SweepGrid, SweepPlot, Tried

_HINT = "choose two parameters and their values, then press Sweep; a click on a cell uses its values"


class SweepPage(QWidget):
    """`axis_chosen(which)`, `sweep_wanted`, `cancel_wanted` and `cell_chosen(row, col)`; knows nothing of methods."""

    axis_chosen = pyqtSignal(int)  # 0 across, 1 down
    sweep_wanted = pyqtSignal()
    cancel_wanted = pyqtSignal()
    cell_chosen = pyqtSignal(int, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.axes, self.values = (QComboBox(), QComboBox()), (QLineEdit(), QLineEdit())
        self.figure, self.go, self.bar = QComboBox(), QPushButton("Sweep"), QProgressBar()
        self.grid, self.plot, self.told = SweepGrid(), SweepPlot(), QLabel(_HINT)
        self._busy = False
        head = spaced(QGridLayout(), 6)
        for which, word in enumerate(("columns", "rows")):
            box, line = self.axes[which], self.values[which]
            box.setObjectName(f"sweep_{word}")
            line.setObjectName(f"sweep_{word}_values")
            box.setAccessibleName(f"parameter of the {word}")
            line.setAccessibleName(f"values of the {word}")
            line.setToolTip("Values, with commas between them")
            box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
            box.activated.connect(partial(self._choose, which))
            line.returnPressed.connect(self.sweep_wanted)
            head.addWidget(QLabel(word), which, 0)
            head.addWidget(box, which, 1)
            head.addWidget(line, which, 2)
        self.figure.setObjectName("sweep_figure")
        self.figure.setAccessibleName("figure that judges")
        self.go.setObjectName("sweep_go")
        self.bar.setTextVisible(False)
        self.bar.setRange(0, 1000)
        self.bar.hide()
        head.addWidget(QLabel("judged by"), 0, 3)
        head.addWidget(self.figure, 0, 4)
        head.addWidget(self.go, 1, 3)
        head.addWidget(self.bar, 1, 4)
        head.setColumnStretch(2, 1)
        self.told.setWordWrap(True)
        self.told.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        both = QSplitter(Qt.Orientation.Horizontal)
        for widget, share in ((self.grid, 3), (self.plot, 2)):
            both.addWidget(widget)
            both.setStretchFactor(both.count() - 1, share)
        layout = spaced(QVBoxLayout(self), 6, (8, 6, 8, 2))
        layout.addLayout(head)
        layout.addWidget(self.told)
        layout.addWidget(both, 1)
        self.go.clicked.connect(self._start_or_stop)
        for one, other in ((self.grid, self.plot), (self.plot, self.grid)):
            one.pointed.connect(one.point)
            one.pointed.connect(other.point)
            one.chosen.connect(self.cell_chosen)

    def _choose(self, which: int, _: int) -> None:
        self.axis_chosen.emit(which)

    def _start_or_stop(self) -> None:
        signal = self.cancel_wanted if self._busy else self.sweep_wanted
        signal.emit()

    def offer(self, words: Sequence[str], chosen: tuple[int, int], figures: Sequence[str], figure: str) -> None:
        """The parameters to choose from, which two are, and the figures; says nothing to anybody."""
        for box, index in zip(self.axes, chosen, strict=True):
            with QSignalBlocker(box):
                if [box.itemText(i) for i in range(box.count())] != list(words):
                    box.clear()
                    box.addItems(list(words))
                box.setCurrentIndex(index)
        with QSignalBlocker(self.figure):
            if [self.figure.itemText(i) for i in range(self.figure.count())] != list(figures):
                self.figure.clear()
                self.figure.addItems(list(figures))
            self.figure.setCurrentText(figure)

    def show_values(self, which: int, values: Sequence[object]) -> None:
        """The values to try along an axis."""
        self.values[which].setText(", ".join(f"{v:g}" if isinstance(v, float) else str(v).lower() for v in values))

    def show_begun(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """An empty grid."""
        for one in (self.grid, self.plot):
            one.used = (-1, -1)
        self.grid.show_axes(across, down, unit)
        self.plot.show_tried({}, unit)

    def show_cell(self, row: int, col: int, tried: Tried) -> None:
        """One more is known."""
        self.grid.show_cell(row, col, tried)
        self.plot.show_tried(self.grid.tried, self.grid.unit)

    def show_used(self, row: int, col: int) -> None:
        """Whose values the window works with."""
        for one in (self.grid, self.plot):
            one.used = (row, col)
            one.update()

    def show_progress(self, fraction: float | None, told: str = "") -> None:
        """How far it is, None when it rests."""
        self._busy = fraction is not None
        self.go.setText("Cancel" if self._busy else "Sweep")
        self.bar.setVisible(self._busy)
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))
        self.told.setText(told or _HINT)
