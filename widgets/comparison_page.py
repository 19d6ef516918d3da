"""Comparison page: variants of one frame in four tabs (methods, two settings, seeds, parameters)."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import get_args

from PyQt6.QtCore import QPointF, QRectF, QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QPainter, QPalette, QPen
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSpinBox, QTabWidget, QVBoxLayout, QWidget

from pipeline.evaluation.method_comparison import SortOrder
from widgets.base import FIXED, ChoiceBox, PaintedWidget, resize_font
from widgets.comparison_tab import ComparisonTab, SweepTab
from widgets.styling import fill, make_command_button, set_spacing
from widgets.theme import ThemeColours, to_qcolor
from widgets.tile_grid import TileGrid
from widgets.view_3d_panel import View3DPanel

ALL_STAGES = "all stages"
MAX_SEEDS = 64
_LEFT_PX, _BELOW_PX, _ROOM_PX, _DOT_PX = 46.0, 34.0, 14.0, 4.0


class SpreadPlot(PaintedWidget):
    """Points (standard deviation, error) in mm, both axes from zero and of equal length, with the diagonal."""

    preferred_px = 280, 280

    def __init__(self) -> None:
        super().__init__("spread_plot", "error against standard deviation", FIXED)
        resize_font(self)
        self.points: tuple[tuple[float, float], ...] = ()
        self.setMinimumWidth(240)
        self.setToolTip(
            "Each point is a group of pixels with similar standard deviation: its mean, and the rms error of the mean"
        )

    def show_points(self, points: Sequence[tuple[float, float]]) -> None:
        """Show these points; the plot is hidden without any."""
        self.points = tuple(points)
        self.setVisible(bool(self.points))
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Draw axes, diagonal and points."""
        if not self.points:
            return
        palette = self.palette()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        most = 1.05 * max(max(point) for point in self.points) or 1.0
        side = min(self.width() - _LEFT_PX - _ROOM_PX, self.height() - _BELOW_PX - 2 * _ROOM_PX)
        left, low = _LEFT_PX, _ROOM_PX + side

        def to_screen(x: float, y: float) -> QPointF:
            return QPointF(left + side * x / most, low - side * y / most)

        painter.setPen(palette.color(QPalette.ColorRole.Mid))
        painter.drawRect(QRectF(left, _ROOM_PX, side, side))
        painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1, Qt.PenStyle.DashLine))
        painter.drawLine(to_screen(0, 0), to_screen(most, most))
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        centre, right = Qt.AlignmentFlag.AlignHCenter, Qt.AlignmentFlag.AlignRight
        painter.drawText(QRectF(left, low + 2, side, 16), right, f"{most:.2g}")
        painter.drawText(QRectF(left, low + 16, side, 16), centre, "standard deviation, mm")
        painter.drawText(QRectF(0, _ROOM_PX - 4, left - 4, 16), right, f"{most:.2g}")
        painter.save()
        painter.translate(12, low)
        painter.rotate(-90)
        painter.drawText(QRectF(0, 0, side, 16), centre, "rms error of the mean, mm")
        painter.restore()
        dots = [to_screen(*point) for point in self.points]
        painter.setPen(QPen(to_qcolor(ink.accent), 1.5))
        for one, other in pairwise(dots):
            painter.drawLine(one, other)
        painter.setBrush(to_qcolor(ink.accent))
        for dot in dots:
            painter.drawEllipse(dot, _DOT_PX, _DOT_PX)


class TileTab(ComparisonTab):
    """A comparison tab whose results are tiles."""

    def __init__(self, controls: Sequence[QWidget]) -> None:
        self.grid = TileGrid()
        super().__init__(controls, self.grid)


class ComparisonPage(QWidget):
    """Tabs by name; `choice_changed` requests what the tab and its controls choose."""

    choice_changed = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        orders = {order: order for order in get_args(SortOrder)}
        self.order_box = ChoiceBox("compare_order", "order of the methods", orders)
        self.stage_box = ChoiceBox("compare_stage", "compared stage")
        self.seed_count_box, self.sample_button = QSpinBox(), QPushButton("Sample")
        self.seed_count_box.setRange(2, MAX_SEEDS)
        self.seed_count_box.setValue(8)
        for widget, name, text in (
            (self.seed_count_box, "compare_seeds", "number of seeds"),
            (self.sample_button, "compare_sample", "Sample the touch with these seeds"),
        ):
            widget.setObjectName(name)
            widget.setAccessibleName(text)
        for changed in (self.order_box.chosen, self.stage_box.chosen, self.seed_count_box.valueChanged):
            changed.connect(self._emit_choice)
        self.methods = TileTab([QLabel("order"), self.order_box])
        self.variants = TileTab([QLabel("stage"), self.stage_box])
        self.seeds = TileTab([QLabel("seeds"), self.seed_count_box, self.sample_button])
        self.sweep = SweepTab()
        self.plot = SpreadPlot()
        self.plot.hide()
        self.seeds.body.addWidget(self.plot)
        self.views_3d, self.row_3d = (View3DPanel(), View3DPanel()), QWidget()
        row = set_spacing(QHBoxLayout(self.row_3d), 4)
        fill(row, *((cell, 1) for cell in self.views_3d), 1)  # empty under the difference, which has no 3D view
        self.variants.stack.addWidget(self.row_3d, 2)
        self.row_3d.hide()
        self.tabs: Mapping[str, TileTab] = {"methods": self.methods, "two": self.variants, "seeds": self.seeds}
        self._pages: Mapping[str, ComparisonTab] = {**self.tabs, "sweep": self.sweep}
        self._tab_bar, self._n_commands = QTabWidget(), 0
        self._tab_bar.setDocumentMode(True)
        self._tab_bar.setObjectName("compare_tabs")
        self._tab_bar.setAccessibleName("comparisons")
        for tab, title in zip(self._pages.values(), ("Methods", "Two settings", "Seeds", "Parameters"), strict=True):
            self._tab_bar.addTab(tab, title)
        layout = set_spacing(QVBoxLayout(self), 0)
        layout.addWidget(self._tab_bar)
        self._tab_bar.currentChanged.connect(self._emit_choice)

    @property
    def current_name(self) -> str:
        """Name of the current tab."""
        return next(name for name, tab in self._pages.items() if tab is self._tab_bar.currentWidget())

    @property
    def current_tab(self) -> TileTab:
        """The current tab; the methods tab while the parameters are shown."""
        return self.tabs.get(self.current_name, self.methods)

    def _emit_choice(self, _: object) -> None:
        self.choice_changed.emit()

    def add_command(self, action: QAction) -> None:
        """Add a button for a command to the tab of two settings."""
        button = make_command_button(action)
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.variants.head.insertWidget(2 + self._n_commands, button)
        self._n_commands += 1

    def show_choices(self, tab: str, order: str, stage: str, seeds: int) -> None:
        """Show the current choices, the last stage for one that is not offered; emits no signal."""
        index = self.stage_box.findData(stage)
        self.order_box.setCurrentText(order)
        self.stage_box.setCurrentIndex(index if index >= 0 else self.stage_box.count() - 1)
        with QSignalBlocker(self._tab_bar), QSignalBlocker(self.seed_count_box):
            self.show_tab(tab)
            self.seed_count_box.setValue(seeds)

    def show_tab(self, name: str) -> None:
        """Bring a tab to the front."""
        self._tab_bar.setCurrentWidget(self._pages[name])
