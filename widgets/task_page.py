"""Page of the *Task* layout: trials, the scene in 3D, touches, force against time, and the error of a decision."""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QPainter, QPalette, QPolygonF
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.previews.colours import Rgb
from pipeline.previews.view import StepCurve
from widgets.base import ChoiceBox
from widgets.error_attribution_panel import DecisionPanel
from widgets.preview_view import PreviewView
from widgets.steps_panel import StepsPlot
from widgets.styling import fill, make_bold, make_splitter, set_spacing
from widgets.theme import ThemeColours, to_hex, to_qcolor
from widgets.timeline import Timeline
from widgets.trials_panel import TrialsPanel
from widgets.view_3d_panel import View3DPanel

_TABLE_SIZE, _SCENE_SIZE = 310, 400  # of 1000: the table in the page, the scene next to the touches
TOUCHES = {"source": "Source", "touch": "Generated touch", "truth": "True touch"}
_MARK_PX = 4.0
_LAST_TIMES = 3  # times written under the plot: first, middle and last


class RolloutPlot(StepsPlot):
    """Click, drag or arrow keys choose a tick; triangles at the top mark decisions, times stand at the bottom."""

    def __init__(self) -> None:
        super().__init__("rollout_plot", "force and motion against time")
        self._times_s: Sequence[float] = ()
        self.decision_ticks: tuple[int, ...] = ()
        self.setMinimumHeight(90)

    def show_rollout(self, curves: Sequence[StepCurve], times_s: Sequence[float], decisions: Sequence[int]) -> None:
        """Show these curves over the times, with marks at the ticks of decisions."""
        self._times_s, self.decision_ticks = times_s, tuple(decisions)
        self.show_curves(curves, ())

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint strips, marks of decisions, and times."""
        super().paint(painter, ink)
        if not self.n_steps:
            return
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(to_qcolor(ink.worse))
        for tick in self.decision_ticks:
            x = self.compute_step_x_px(tick)
            corners = (QPointF(x - _MARK_PX, 0), QPointF(x + _MARK_PX, 0), QPointF(x, 1.7 * _MARK_PX))
            painter.drawPolygon(QPolygonF(corners))
        painter.setPen(self.palette().color(QPalette.ColorRole.PlaceholderText))
        height = self.fontMetrics().height()
        for k in range(_LAST_TIMES):
            tick = round(k * (self.n_steps - 1) / (_LAST_TIMES - 1))
            x = self.compute_step_x_px(tick)
            room = QRectF(x - (90 if k == _LAST_TIMES - 1 else 0 if k == 0 else 45), self.height() - height, 90, height)
            align = (Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignHCenter, Qt.AlignmentFlag.AlignRight)[k]
            painter.drawText(room, align, f"{self._times_s[tick]:.2f} s")


class TaskPage(QWidget):
    """Trials at the left; scene and touches over the plot, the ticks and the decision at the right."""

    def __init__(self) -> None:
        super().__init__()
        self.trials, self.scene, self.plot = TrialsPanel(), View3DPanel(), RolloutPlot()
        self.decision, self.ticks, self.message = DecisionPanel(), Timeline(unit="tick"), QLabel()
        self.scene.view.setAccessibleName("scene of the rollout")
        self.scene.view.setMinimumSize(220, 160)
        self.message.setWordWrap(True)
        self.place_box = ChoiceBox("task_place", "finger of the touches")  # by stream
        self.views = {name: PreviewView() for name in TOUCHES}
        across, down = Qt.Orientation.Horizontal, Qt.Orientation.Vertical
        upper = make_splitter(across, (self.scene, 4), (self._build_touches(), 5))
        lower = make_splitter(down, (upper, 5), (self._build_ticks(), 3), (self.decision, 2))
        self.split = make_splitter(across, (self.trials, 3), (lower, 7))
        self.split.setObjectName("task_split")
        upper.setSizes([_SCENE_SIZE, 1000 - _SCENE_SIZE])
        self.split.setSizes([_TABLE_SIZE, 1000 - _TABLE_SIZE])
        fill(set_spacing(QVBoxLayout(self), 2, (2, 2, 2, 2)), self.message, (self.split, 1))
        self.show_message("")
        self.clear()

    def _build_touches(self) -> QWidget:
        panel = QWidget()
        row = set_spacing(QHBoxLayout(), 4)
        for name, title in TOUCHES.items():
            label = QLabel(title)
            make_bold(label)
            view = self.views[name]
            view.setObjectName(f"task_{name}")
            view.setAccessibleName(title)
            fill(row, (fill(set_spacing(QVBoxLayout(), 1), label, (view, 1)), 1))
        fill(set_spacing(QVBoxLayout(panel), 2), fill(QHBoxLayout(), self.place_box, 1), (row, 1))
        return panel

    def _build_ticks(self) -> QWidget:
        panel = QWidget()
        fill(set_spacing(QVBoxLayout(panel), 0), (self.plot, 1), self.ticks)
        return panel

    def show_message(self, text: str) -> None:
        """Show why there is nothing to see; "" hides it."""
        self.message.setText(text)
        self.message.setVisible(bool(text))

    def offer_places(self, places: Mapping[str, str], chosen: str) -> None:
        """Offer stream -> title of the fingers; emits no signal."""
        self.place_box.offer(places, chosen)
        self.place_box.setVisible(len(places) > 1)

    def show_legend(self, estimate: Rgb, truth: Rgb, *, has_estimate: bool) -> None:
        """Name the two poses by their colours and line styles."""
        lines = [f"<span style='color:{to_hex(truth)}'>\N{BLACK SQUARE}</span> true pose, solid"]
        if has_estimate:
            lines.append(f"<span style='color:{to_hex(estimate)}'>\N{BOX DRAWINGS LIGHT TRIPLE DASH HORIZONTAL}"
                         "\N{BOX DRAWINGS LIGHT TRIPLE DASH HORIZONTAL}</span> estimated pose, dashed")  # fmt: skip
        self.scene.caption.set_texts(" &nbsp; ".join(lines))
        self.scene.show()

    def clear(self) -> None:
        """Show no rollout, and no empty scene."""
        self.scene.hide()
        self.plot.show_rollout((), (), ())
        self.ticks.show_frames(0)
        self.scene.legend.setText("")
        self.decision.show_decision("", None, can_attribute=False)
        for view in self.views.values():
            view.show_preview(None)
            view.show_message("")
