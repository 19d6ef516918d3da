"""Tabs of the comparison page: controls, a message with progress, and results; one sweeps two parameters."""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from pipeline.evaluation.parameter_sweep import SweepCell, format_value
from widgets.base import ChoiceBox
from widgets.run_bar import RunBar
from widgets.styling import fill, make_splitter, set_spacing
from widgets.sweep_grid import SweepGrid, SweepPlot


class ComparisonTab(QWidget):
    """Controls above a message above the widget with the results."""

    def __init__(self, controls: Sequence[QWidget] | QLayout, results: QWidget) -> None:
        super().__init__()
        self.message, self.run_bar = QLabel(), RunBar("compare", keeps_room=True)
        self.message.setWordWrap(True)
        self.message.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        self.head = set_spacing(QHBoxLayout(), 6)
        fill(self.head, *([(controls, 1)] if isinstance(controls, QLayout) else [*controls, 1]))
        self.body = fill(set_spacing(QHBoxLayout(), 6), (results, 1))
        self.stack = fill(
            set_spacing(QVBoxLayout(self), 4, (4, 4, 4, 2)), self.head,
            fill(set_spacing(QHBoxLayout(), 6), (self.message, 1), self.run_bar), (self.body, 3),
        )  # fmt: skip


_AXES = "columns", "rows"
_HINT = "choose two parameters and their values, then press Sweep; click a cell to use its values"


class SweepTab(ComparisonTab):
    """Parameters, values and metric of a sweep, and its cells."""

    def __init__(self) -> None:
        self.axes = tuple(ChoiceBox(f"sweep_{word}", f"parameter of the {word}") for word in _AXES)  # across, down
        self.values = QLineEdit(), QLineEdit()
        self.metric_box, self.start_button = ChoiceBox("sweep_metric", "metric"), QPushButton("Sweep")
        self.grid, self.plot = SweepGrid(), SweepPlot()
        controls = set_spacing(QGridLayout(), 6)
        results = make_splitter(Qt.Orientation.Horizontal, (self.grid, 3), (self.plot, 2))
        super().__init__(controls, results)
        for which, (word, box, line) in enumerate(zip(_AXES, self.axes, self.values, strict=True)):
            line.setObjectName(f"sweep_{word}_values")
            line.setAccessibleName(f"values of the {word}")
            line.setToolTip("Comma-separated values")
            line.returnPressed.connect(self.start_button.click)
            for col, widget in enumerate((QLabel(word), box, line)):
                controls.addWidget(widget, which, col)
        self.start_button.setObjectName("sweep_start")
        controls.addWidget(QLabel("metric"), 0, 3)
        controls.addWidget(self.metric_box, 0, 4)
        controls.addWidget(self.start_button, 1, 4)
        controls.setColumnStretch(2, 1)
        self.message.setText(_HINT)
        for view, other in ((self.grid, self.plot), (self.plot, self.grid)):
            view.cell_hovered.connect(view.mark_cell)
            view.cell_hovered.connect(other.mark_cell)

    def offer_parameters(
        self, names: Sequence[str], chosen: tuple[int, int], metrics: Mapping[str, str], metric: str
    ) -> None:
        """Offer parameters and metrics (name -> title) and show the chosen ones; emits no signal."""
        for box, index in zip(self.axes, chosen, strict=True):
            box.offer({name: name for name in names}, names[index] if names else "")
        self.metric_box.offer(metrics, metric)

    def show_values(self, which: int, values: Sequence[object]) -> None:
        """Show the values of an axis."""
        self.values[which].setText(", ".join(format_value(value) for value in values))

    def start_sweep(self, across: tuple[str, Sequence[str]], down: tuple[str, Sequence[str]], unit: str) -> None:
        """Show an empty grid with (name, values) of columns and rows."""
        self.grid.start_sweep(across, down, unit)
        self.plot.show_unit(unit)

    def show_cell(self, cell: SweepCell) -> None:
        """Add one result."""
        for view in (self.grid, self.plot):
            view.show_cell(cell)

    def mark_used_cell(self, row: int, col: int) -> None:
        """Mark the cell whose values are in use."""
        for view in (self.grid, self.plot):
            view.mark_used_cell(row, col)

    def show_state(self, message: str, *, runs: bool) -> None:
        """Show a message, and whether another sweep can start."""
        self.message.setText(message)
        self.start_button.setDisabled(runs)
