"""Tabs of the comparison page: controls, a message with progress, and results as tiles or as a
grid.
"""

from collections.abc import Mapping, Sequence
from functools import partial

from PyQt6.QtWidgets import (
    QGridLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QSizePolicy,
    QWidget,
)

from pipeline.lab.evaluation.comparison_tiles import Comparison
from pipeline.lab.evaluation.grid_comparison import GridComparison, GridPlan, format_value
from widgets.compare.comparison_grid import CellGrid
from widgets.compare.tile_grid import TileGrid
from widgets.style.base import ChoiceBox
from widgets.style.run_bar import RunBar
from widgets.style.styling import (
    make_button,
    make_column,
    make_line,
    make_row,
    make_text,
    set_spacing,
)


class ComparisonTab(QWidget):
    """Controls above a message above the widget with the results."""

    def __init__(self, controls: Sequence[QWidget] | QLayout, results: QWidget) -> None:
        super().__init__()
        self.message = make_text()
        self.run_bar = RunBar("compare", keeps_room=True)
        self.message.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Minimum)
        parts = [(controls, 1)] if isinstance(controls, QLayout) else [*controls, 1]
        self.head = make_row(6, *parts)
        make_column(
            4,
            self.head,
            make_row(6, (self.message, 1), self.run_bar),
            (results, 3),
            around_px=(4, 4, 4, 2),
            on=self,
        )

    def show_comparison(self, comparison: Comparison) -> None:
        """Show what is computed so far."""
        self.message.setText(comparison.summary)


class TileTab(ComparisonTab):
    """A tab whose results are tiles."""

    def __init__(self, controls: Sequence[QWidget]) -> None:
        self.grid = TileGrid()
        super().__init__(controls, self.grid)

    def show_comparison(self, comparison: Comparison) -> None:
        """Show the tiles."""
        super().show_comparison(comparison)
        self.grid.show_tiles(comparison.tiles)


_AXES = "columns", "rows"
GRID_HINT = "choose what columns and rows try, then press Start; a click on a cell uses its values"


class GridTab(ComparisonTab):
    """Axes, values and metric of a grid, and its cells."""

    def __init__(self) -> None:
        # across, down
        self.axes = tuple(ChoiceBox(f"grid_{word}", f"what the {word} try") for word in _AXES)
        self.values = tuple(
            make_line(f"grid_{word}_values", f"values of the {word}", "", "Comma-separated values")
            for word in _AXES
        )
        self.metric_box = ChoiceBox("grid_metric", "metric")
        self.start_button = make_button("Start", "grid_start")
        self.grid = CellGrid()
        self._offers: Mapping[str, str] = {}
        controls = set_spacing(QGridLayout(), 6)
        super().__init__(controls, self.grid)
        for which, (word, box, line) in enumerate(zip(_AXES, self.axes, self.values, strict=True)):
            line.returnPressed.connect(self.start_button.click)
            box.chosen.connect(partial(self._suggest_values, line))
            for col, widget in enumerate((QLabel(word), box, line)):
                controls.addWidget(widget, which, col)
        controls.addWidget(QLabel("metric"), 0, 3)
        controls.addWidget(self.metric_box, 0, 4)
        controls.addWidget(self.start_button, 1, 4)
        controls.setColumnStretch(2, 1)
        self.message.setText(GRID_HINT)

    def _suggest_values(self, line: QLineEdit, title: str) -> None:
        line.setText(self._offers.get(title, ""))

    def offer_axes(
        self,
        offers: Mapping[str, str],
        metrics: Mapping[str, str],
        metric: str,
        labels: Mapping[str, str],
    ) -> None:
        """Offer axes (name -> suggested values) with their `labels`, and metrics (name -> title);
        emits no signal.

        The chosen axes and their values stay while they are offered, else the first ones are
        chosen.
        """
        first = (*offers, "", "")[:2]
        self._offers = offers
        columns = {name: labels.get(name, name) for name in offers}
        for box, line, default, titles in zip(
            self.axes, self.values, first, (columns, {"": "one row", **columns}), strict=True
        ):
            keeps = box.count() > 0 and box.choice in titles
            box.offer(titles, box.choice if keeps else default)
            if not keeps:
                line.setText(offers.get(default, ""))
        self.metric_box.offer(metrics, metric)

    @property
    def axis_texts(self) -> tuple[str, str]:
        """Columns and rows as `stage.name=value,value`; "" for one row."""
        across, down = (
            f"{box.choice}={line.text()}" if box.choice else ""
            for box, line in zip(self.axes, self.values, strict=True)
        )
        return across, down

    def show_plan(self, plan: GridPlan | None, unit: str = "") -> None:
        """Show an empty grid, or none."""
        axes = () if plan is None else plan.axes
        values = [[format_value(value) for value in axis.values] for axis in axes]
        across, down = (*values, [""] if values else [], list[str]())[:2]
        self.grid.show_axes(across, down, unit)

    def show_comparison(self, comparison: Comparison) -> None:
        """Show the newest cell."""
        super().show_comparison(comparison)
        if isinstance(comparison, GridComparison) and comparison.cells:
            self.grid.show_cell(comparison.cells[-1])
