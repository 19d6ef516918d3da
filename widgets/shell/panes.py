"""*Look*: all stages as cards, and up to three of them large beside the inspector."""

from collections.abc import Mapping, Sequence
from functools import partial

from PyQt6.QtCore import QEvent, QObject, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QPalette
from PyQt6.QtWidgets import (
    QFrame,
    QLabel,
    QSplitter,
    QToolButton,
    QWidget,
)

from widgets.stages.stage_column import StageColumn
from widgets.style.base import EventListener
from widgets.style.styling import (
    make_bold,
    make_column,
    make_row,
    make_single_shot_timer,
    name_widget,
)
from widgets.timeline.filmstrip import Filmstrip
from widgets.views.view_3d_panel import View3DPanel

_MOST_HIGH = 0.74  # largest share of a pane's height for the image when stacked
# limits of its share of the width when side by side
_LEAST_WIDE = 0.45
_MOST_WIDE = 0.66
_USUAL_TALL = 0.78  # rows over columns for the layout: all panes use the same one
# gain in image size that switches to side by side, and back
_WORTH = 1.15
_STILL = 1.08
_WAY = Qt.Orientation
# what a pane shows, in words
DIMS = {
    "2D": "2D",
    "3D": "3D",
    "both": "the image and the 3D view",
    "scene": "both sensors and the object",
}
MAX_PANES = 3
_LARGE = 1.5  # letters of a title that is alone
_SCENE_TITLE = "Both sensors and the object"
_LEAST_WIDE_PX = 480
_COLLAPSED_BELOW_PX = 550  # a lower page collapses the cards to names


class PaneSplitter(QSplitter):
    """Image and 3D view of a stage, above each other or side by side: whatever makes the image
    larger, until the user drags the handle.
    """

    def __init__(self) -> None:
        super().__init__(_WAY.Vertical)
        self.setChildrenCollapsible(False)
        self._is_user_sized = False
        self._held: tuple[StageColumn, View3DPanel] | None = None
        self._soon = make_single_shot_timer(self, 0, self.fit_sizes)
        self.splitterMoved.connect(self._keep_sizes)
        EventListener(self, self._soon.start, QEvent.Type.Resize)

    def _keep_sizes(self) -> None:
        self._is_user_sized = True

    def set_contents(self, column: StageColumn, cell: View3DPanel) -> None:
        """Show these widgets; the previous ones must have been released."""
        self._is_user_sized = False
        for widget in (column, cell):
            self.addWidget(widget)
        column.view.shape_changed.connect(self._soon.start)
        self._held = column, cell
        self._soon.start()

    def release_contents(self) -> None:
        """Release the widgets before they move to another parent."""
        if self._held is not None:
            self._held[0].view.shape_changed.disconnect(self._soon.start)
        self._held = None

    def fit_sizes(self) -> None:
        """Choose the sizes that make the image largest, unless the user set them."""
        if self._held is None or self._is_user_sized:
            return
        column, cell = self._held
        if not (self._shows(column) and self._shows(cell)):
            return
        around = column.size() - column.view.canvas.size()
        stands = self.orientation() == _WAY.Vertical
        stacked, beside = self._choose_sizes(around, _USUAL_TALL)
        under, at_side = (stacked - around.height()) / _USUAL_TALL, beside - around.width()
        if at_side > _WORTH * under if stands else at_side < _STILL * under:
            stands = not stands
            self.setOrientation(_WAY.Vertical if stands else _WAY.Horizontal)
        stacked, beside = self._choose_sizes(around, column.view.height_over_width)
        first = round(stacked if stands else max(_LEAST_WIDE * self.width(), beside))
        if abs(self.sizes()[0] - first) > 1:
            whole = self.height() if stands else self.width()
            self.setSizes([first, whole - self.handleWidth() - first])

    def _choose_sizes(self, around: QSize, tall: float) -> tuple[float, float]:
        """Return height and width of the column stacked over the 3D view and next to it, from its
        size without the image, and rows over columns of that.
        """
        room = self.size() - QSize(self.handleWidth(), self.handleWidth())
        stacked = around.height() + tall * (room.width() - around.width())
        beside = around.width() + (room.height() - around.height()) / tall
        return min(stacked, _MOST_HIGH * room.height()), min(beside, _MOST_WIDE * room.width())

    def _shows(self, widget: QWidget) -> bool:
        return widget.parentWidget() is self and widget.isVisibleTo(self)


class Pane(QFrame):
    """A column and its 3D view, together or alone; `activated` by a click anywhere in it."""

    activated = pyqtSignal()
    dims_chosen = pyqtSignal(str)

    def __init__(self, number: int) -> None:
        super().__init__()
        self.setObjectName(f"pane_{number}")
        self._rim = QFrame()
        self._rim.setFixedHeight(2)
        self._rim.setAutoFillBackground(True)
        self._buttons = {
            dims: name_widget(
                QToolButton(), f"pane_{number}_{dims.lower()}", tip=f"Show {words} in this pane"
            )
            for dims, words in DIMS.items()
        }
        for dims, button in self._buttons.items():
            button.setText(dims)
            button.setCheckable(True)
            button.setAutoRaise(True)
            button.clicked.connect(partial(self.dims_chosen.emit, dims))
        self._both = PaneSplitter()
        self._both.setObjectName(f"split_pane_{number}")
        self._title = make_bold(QLabel(_SCENE_TITLE))
        self._title.setIndent(4)
        self._head = make_row(0, (self._title, 1), *self._buttons.values())
        make_column(0, self._rim, self._head, (self._both, 1), on=self)
        self._held: tuple[StageColumn, View3DPanel] | None = None
        self._dims = ""
        self._own_title = ""
        self.installEventFilter(self)

    def set_contents(self, column: StageColumn, cell: View3DPanel, dims: str) -> None:
        """Show these widgets; the previous ones must have been released."""
        if self._held != (column, cell):
            self._both.release_contents()
            self._both.set_contents(column, cell)
            self._head.insertWidget(0, column.head, 1)
            for widget in (column, column.head, cell):
                _watch(widget, self)
            self._held = column, cell
        self._dims = dims
        self.show_title(self._own_title)
        column.setVisible(dims in ("2D", "both"))
        cell.setVisible(dims != "2D")
        for name, button in self._buttons.items():
            button.setChecked(name == dims)

    def show_title(self, text: str) -> None:
        """Show a large text in place of all controls; "" for the usual head."""
        self._own_title = text
        font = self._title.font()
        font.setPointSizeF(self.font().pointSizeF() * (_LARGE if text else 1.0))
        self._title.setFont(font)
        self._title.setText(text or _SCENE_TITLE)
        self._title.setWordWrap(bool(text))
        self._title.setVisible(bool(text) or self._dims == "scene")
        if self._held is not None:
            self._held[0].head.setVisible(not text and self._dims != "scene")
        for button in self._buttons.values():
            button.setHidden(bool(text))

    def release_contents(self) -> None:
        """Hide and release the widgets before they move to another pane."""
        if self._held is not None:
            head = self._held[0].head
            self._head.removeWidget(head)
            for widget in (*self._held, head):
                widget.setParent(self)  # out of the splitter
                widget.hide()
        self._both.release_contents()
        self._held = None

    def set_active(self, active: bool) -> None:
        """Set whether a click on a card fills this pane."""
        role = QPalette.ColorRole
        self._rim.setBackgroundRole(role.Highlight if active else role.Midlight)

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """Activate the pane on a press in it or in any child."""
        if a1 is not None and a1.type() == QEvent.Type.MouseButtonPress:
            self.activated.emit()
        return super().eventFilter(a0, a1)


class LookPage(QWidget):
    """Cards over panes with the inspector at their right.

    Emits `stage_chosen(pane, stage)`, `stage_toggled(stage)` and `dims_chosen(pane, dims)`.
    """

    stage_chosen = pyqtSignal(int, str)
    stage_toggled = pyqtSignal(str)
    dims_chosen = pyqtSignal(int, str)
    active_changed = pyqtSignal(str)  # the stage in the active pane

    def __init__(self, titles: Mapping[str, str], inspector: QWidget) -> None:
        super().__init__()
        self.filmstrip = Filmstrip(titles)
        self.inspector = inspector
        self.panes = tuple(Pane(number + 1) for number in range(MAX_PANES))
        self.active_pane = 1
        self._stages: tuple[str, ...] = ()
        self._has_scene: list[bool] = []  # in place of the stage, by pane
        row = make_row(4, *((pane, 1) for pane in self.panes), inspector)
        make_column(4, self.filmstrip, (row, 1), on=self)
        for number, pane in enumerate(self.panes):
            pane.activated.connect(partial(self.activate_pane, number))
            pane.dims_chosen.connect(partial(self.dims_chosen.emit, number))
        self.filmstrip.stage_chosen.connect(self.choose_stage)
        self.filmstrip.stage_toggled.connect(self.stage_toggled)
        EventListener(self, self._collapse_cards, QEvent.Type.Resize)

    @property
    def active_stage(self) -> str:
        """The stage in the active pane; "" where there is none."""
        return self._stages[self.active_pane] if self._stages else ""

    def choose_stage(self, stage: str) -> None:
        """Activate the pane that shows a stage, else ask for it in the active one."""
        pane = self._stages.index(stage) if stage in self._stages else self.active_pane
        self.activate_pane(pane)
        if self.active_stage != stage or self._has_scene[pane]:
            self.stage_chosen.emit(pane, stage)

    def activate_pane(self, number: int) -> None:
        """Make this pane the one that a click on a card fills."""
        self.active_pane = min(number, max(0, len(self._stages) - 1))
        for other, pane in enumerate(self.panes):
            pane.set_active(other == self.active_pane)
        self.filmstrip.show_pane_stages(self._stages, self.active_stage)
        self.active_changed.emit(self.active_stage)

    def show_panes(self, held: Sequence[tuple[str, StageColumn, View3DPanel, str]]) -> None:
        """Show (stage, column, cell, dims) in one pane each."""
        stages = tuple(stage for stage, *_ in held)
        has_scene = [dims == "scene" for *_, dims in held]
        if (stages, has_scene) != (self._stages, self._has_scene):
            for pane in self.panes:
                pane.release_contents()
        self._stages, self._has_scene = stages, has_scene
        for number, pane in enumerate(self.panes):
            pane.setVisible(number < len(held))
            if number < len(held):
                pane.set_contents(*held[number][1:])
        self.activate_pane(self.active_pane)

    def show_titles(self, titles: Mapping[tuple[str, bool], str]) -> None:
        """Show (stage, whether it is the scene) -> title in the panes; {} shows their controls."""
        for pane, stage, has_scene in zip(self.panes, self._stages, self._has_scene, strict=False):
            pane.show_title(titles.get((stage, has_scene), ""))

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return little: neither the cards, which collapse, nor three heads keep the window from
        being small.
        """
        hint = super().minimumSizeHint()
        least_px = min(hint.width(), _LEAST_WIDE_PX)
        return QSize(least_px, hint.height() - self.filmstrip.collapsible_px)

    def _collapse_cards(self) -> None:
        self.filmstrip.set_collapsed(self.height() < _COLLAPSED_BELOW_PX)


def _watch(widget: QWidget, by: QObject) -> None:
    """Install an event filter on a widget and its children."""
    for one in (widget, *widget.findChildren(QWidget)):
        one.removeEventFilter(by)
        one.installEventFilter(by)
