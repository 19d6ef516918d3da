"""Parameters tab of the comparison page: two parameters with their values, a grid of results, error against time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import QComboBox, QGridLayout, QLabel, QLineEdit, QPushButton, QSplitter, QWidget

from pipeline.evaluation.parameter_sweep import SweepCell, format_value
from widgets.comparison_tab import ComparisonTab
from widgets.styling import set_spacing
from widgets.sweep_grid import SweepGrid, SweepPlot

_HINT = "choose two parameters and their values, then press Sweep; click a cell to use its values"


class SweepTab(ComparisonTab):
    """Parameters, values and metric of a sweep, and its cells."""

    axis_chosen = pyqtSignal(int)  # 0 across, 1 down
    sweep_requested = pyqtSignal()
    cell_chosen = pyqtSignal(int, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        self.axes, self.values = (QComboBox(), QComboBox()), (QLineEdit(), QLineEdit())
        self.metric_box, self.start_button = QComboBox(), QPushButton("Sweep")
        self.grid, self.plot = SweepGrid(), SweepPlot()
        controls = set_spacing(QGridLayout(), 6)
        results = QSplitter(Qt.Orientation.Horizontal)
        for widget, share in ((self.grid, 3), (self.plot, 2)):
            results.addWidget(widget)
            results.setStretchFactor(results.count() - 1, share)
        super().__init__(controls, results, parent)
        for which, word in enumerate(("columns", "rows")):
            box, line = self.axes[which], self.values[which]
            box.setObjectName(f"sweep_{word}")
            line.setObjectName(f"sweep_{word}_values")
            box.setAccessibleName(f"parameter of the {word}")
            line.setAccessibleName(f"values of the {word}")
            line.setToolTip("Comma-separated values")
            box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
            box.activated.connect(partial(self._emit_axis, which))
            line.returnPressed.connect(self.sweep_requested)
            for col, widget in enumerate((QLabel(word), box, line)):
                controls.addWidget(widget, which, col)
        self.metric_box.setObjectName("sweep_metric")
        self.metric_box.setAccessibleName("metric")
        self.start_button.setObjectName("sweep_start")
        self.start_button.clicked.connect(self.sweep_requested)
        controls.addWidget(QLabel("metric"), 0, 3)
        controls.addWidget(self.metric_box, 0, 4)
        controls.addWidget(self.start_button, 1, 4)
        controls.setColumnStretch(2, 1)
        self.message.setText(_HINT)
        for view, other in ((self.grid, self.plot), (self.plot, self.grid)):
            view.cell_hovered.connect(view.mark_cell)
            view.cell_hovered.connect(other.mark_cell)
            view.cell_chosen.connect(self.cell_chosen)

    def _emit_axis(self, which: int, _: int) -> None:
        self.axis_chosen.emit(which)

    def offer_parameters(
        self, names: Sequence[str], chosen: tuple[int, int], metrics: Mapping[str, str], metric: str
    ) -> None:
        """Offer parameters and metrics (name -> title) and show the chosen ones; emits no signal."""
        for box, index in zip(self.axes, chosen, strict=True):
            _fill_box(box, {name: name for name in names}, index)
        _fill_box(self.metric_box, metrics, list(metrics).index(metric))

    def show_values(self, which: int, values: Sequence[object]) -> None:
        """Show the values of an axis."""
        self.values[which].setText(", ".join(format_value(value) for value in values))

    def start_sweep(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """Show an empty grid with (name, values) of columns and rows."""
        for view in (self.grid, self.plot):
            view.used_cell = (-1, -1)
        self.grid.show_axes(across, down, unit)
        self.plot.show_cells({}, unit)

    def show_cell(self, cell: SweepCell) -> None:
        """Add one result."""
        self.grid.show_cell(cell)
        self.plot.show_cells(self.grid.cells, self.grid.unit)

    def mark_used_cell(self, row: int, col: int) -> None:
        """Mark the cell whose values are in use."""
        for view in (self.grid, self.plot):
            view.used_cell = (row, col)
            view.update()

    def show_progress(self, fraction: float | None, message: str = "") -> None:
        """Show the fraction done (None = not running) and a message, if given."""
        super().show_progress(fraction)
        self.start_button.setEnabled(fraction is None)
        if message:
            self.message.setText(message)


def _fill_box(box: QComboBox, items: Mapping[str, str], index: int) -> None:
    """Offer items (name -> text) and choose one."""
    with QSignalBlocker(box):
        if [box.itemData(i) for i in range(box.count())] != list(items):
            box.clear()
            for name, text in items.items():
                box.addItem(text, name)
        box.setCurrentIndex(index)
