"""Page of the *Task* layout: trials, the scene in 3D, touches, force against time, and the error
of a decision.
"""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QWidget

from pipeline.views.colours import Rgb
from pipeline.views.view import StepCurve
from widgets.frames.error_attribution_panel import DecisionPanel
from widgets.stages.steps_panel import make_curve_strips
from widgets.style.base import ChoiceBox
from widgets.style.plots import StripPlot
from widgets.style.styling import (
    fill,
    make_bold,
    make_column,
    make_command_button,
    make_row,
    make_splitter,
    make_text,
    name_widget,
)
from widgets.style.theme import to_hex
from widgets.task.trials_panel import TrialsPanel
from widgets.timeline.timeline import Timeline
from widgets.views.preview_view import PreviewView
from widgets.views.view_3d_panel import View3DPanel

# of 1000: the table in the page, the scene next to the touches
_TABLE_SIZE = 310
_SCENE_SIZE = 400
TOUCHES = {"source": "Source", "touch": "Generated touch", "truth": "True touch"}


class TaskPage(QWidget):
    """Trials at the left; scene and touches over the plot, the ticks and the decision at the
    right.
    """

    def __init__(self) -> None:
        super().__init__()
        self.trials = TrialsPanel()
        self.scene = View3DPanel()
        self.plot = StripPlot("rollout_plot", "force and motion against time")
        self.decision = DecisionPanel()
        self.ticks = Timeline(unit="tick")
        self.message = make_text()
        self.plot.setMinimumHeight(90)
        self.plot.setToolTip("Triangles mark decisions")
        self.scene.view.setAccessibleName("scene of the rollout")
        self.scene.view.setMinimumSize(220, 160)
        self.place_box = ChoiceBox("task_place", "finger of the touches")  # by stream
        self.views = {name: PreviewView() for name in TOUCHES}
        across = Qt.Orientation.Horizontal
        down = Qt.Orientation.Vertical
        upper = make_splitter(across, (self.scene, 4), (self._build_touches(), 5))
        lower = make_splitter(down, (upper, 5), (self._build_ticks(), 3), (self.decision, 2))
        self.split = make_splitter(across, (self.trials, 3), (lower, 7))
        self.split.setObjectName("task_split")
        upper.setSizes([_SCENE_SIZE, 1000 - _SCENE_SIZE])
        self.split.setSizes([_TABLE_SIZE, 1000 - _TABLE_SIZE])
        self._empty = QWidget()
        self._head = fill(QHBoxLayout(self._empty), (self.message, 1))
        make_column(2, self._empty, (self.split, 1), 0, around_px=(2, 2, 2, 2), on=self)
        self.show_message("")
        self.clear()

    def _build_touches(self) -> QWidget:
        panel = QWidget()
        row = make_row(4)
        for name, title in TOUCHES.items():
            view = name_widget(self.views[name], f"task_{name}", title)
            label = make_bold(QLabel(title))
            fill(row, (make_column(1, label, (view, 1)), 1))
        make_column(2, make_row(6, self.place_box, 1), (row, 1), on=panel)
        return panel

    def _build_ticks(self) -> QWidget:
        panel = QWidget()
        make_column(0, (self.plot, 1), self.ticks, on=panel)
        return panel

    def show_curves(
        self, curves: Sequence[StepCurve], times_s: Sequence[float], decisions: Sequence[int]
    ) -> None:
        """Show these curves over the times, with marks at the ticks of decisions."""
        self.plot.show_strips(
            make_curve_strips(curves), [f"{time_s:.2f} s" for time_s in times_s], marks=decisions
        )

    def show_message(self, text: str) -> None:
        """Show why there is nothing to see; "" hides it."""
        self.message.setText(text)
        self._empty.setVisible(bool(text))

    def add_command(self, action: QAction) -> None:
        """Add a command beside the message."""
        self._head.insertWidget(0, make_command_button(action))

    def offer_places(self, places: Mapping[str, str], chosen: str) -> None:
        """Offer stream -> title of the fingers; emits no signal."""
        self.place_box.offer(places, chosen)
        self.place_box.setVisible(len(places) > 1)

    def show_legend(self, estimate: Rgb, truth: Rgb, *, has_estimate: bool) -> None:
        """Name the two poses by their colours and line styles."""
        lines = [f"<span style='color:{to_hex(truth)}'>\N{BLACK SQUARE}</span> true pose, solid"]
        if has_estimate:
            dashes = 2 * "\N{BOX DRAWINGS LIGHT TRIPLE DASH HORIZONTAL}"
            lines.append(
                f"<span style='color:{to_hex(estimate)}'>{dashes}</span> estimated pose, dashed"
            )
        self.scene.caption.set_texts(" &nbsp; ".join(lines))
        self.scene.show()

    def clear(self) -> None:
        """Show no rollout, and no empty scene."""
        self.scene.hide()
        self.plot.show_strips(())
        self.ticks.show_frames(0)
        self.scene.legend.setText("")
        self.decision.show_decision("", None, can_attribute=False)
        for view in self.views.values():
            view.show_preview(None)
            view.show_message("")
