"""A picture and its 3D view in one pane: below each other, or side by side where that leaves the picture larger."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QSplitter, QWidget

from widgets.stage_column import StageColumn
from widgets.styling import make_single_shot_timer
from widgets.view_3d_panel import View3DPanel

_MOST_HIGH = 0.74  # of a pane's height that the picture has at most, where both stand below each other
_LEAST_WIDE, _MOST_WIDE = 0.45, 0.66  # of its width, where they stand side by side
_USUAL_TALL = 0.78  # rows over columns: all panes are arranged alike, whatever they show
_WORTH, _STILL = 1.15, 1.08  # as much larger the picture is side by side before they change places, and before back
_WAY = Qt.Orientation


class PaneSplitter(QSplitter):
    """Follows the picture until somebody drags the handle."""

    def __init__(self) -> None:
        super().__init__(_WAY.Vertical)
        self.setChildrenCollapsible(False)
        self.is_user_sized = False  # from then on both keep their share
        self._held: tuple[StageColumn, View3DPanel] | None = None
        self._soon = make_single_shot_timer(self, 0, self.fit_sizes)
        self.splitterMoved.connect(self._keep)

    def set_contents(self, column: StageColumn, cell: View3DPanel) -> None:
        """Show these; what was held before must have been taken elsewhere."""
        self.is_user_sized = False
        for widget in (column, cell):
            self.addWidget(widget)
        column.view.shape_changed.connect(self._soon.start)
        self._held = column, cell
        self._soon.start()

    def release_contents(self) -> None:
        """What is held is about to be taken elsewhere."""
        if self._held is not None:
            self._held[0].view.shape_changed.disconnect(self._soon.start)
        self._held = None

    def restore_sizes(self, sizes: Sequence[int]) -> None:
        """Stand as somebody dragged it once; without sizes, follow the picture again."""
        self.is_user_sized = len(sizes) == self.count()
        if self.is_user_sized:
            self.setSizes(list(sizes))
        else:
            self._soon.start()

    def fit_sizes(self) -> None:
        """Share the room out so that the picture is largest, where nobody chose another share."""
        if self._held is None or self.is_user_sized or not all(_seen(widget, self) for widget in self._held):
            return
        column, _ = self._held
        around, room = _around(column), self.size() - QSize(self.handleWidth(), self.handleWidth())
        under, beside = _wide(room, around, _USUAL_TALL)
        stands = self.orientation() == _WAY.Vertical
        if beside > _WORTH * under if stands else beside < _STILL * under:
            self.setOrientation(_WAY.Horizontal if stands else _WAY.Vertical)
            stands = not stands
        tall = column.view.height_over_width
        under, beside = _wide(room, around, tall)
        if stands:
            whole, first = room.height(), round(around.height() + tall * under)
        else:
            whole, first = room.width(), round(max(_LEAST_WIDE * room.width(), around.width() + beside))
        if abs(self.sizes()[0] - first) > 1:
            self.setSizes([first, whole - first])

    def resizeEvent(self, a0: QResizeEvent | None) -> None:  # noqa: N802
        """Other room, other shares."""
        super().resizeEvent(a0)
        self._soon.start()

    def _keep(self) -> None:
        self.is_user_sized = True


def _seen(widget: QWidget, by: QWidget) -> bool:
    return widget.parentWidget() is by and widget.isVisibleTo(by)


def _wide(room: QSize, around: QSize, tall: float) -> tuple[float, float]:
    """The picture's width over the 3D view, and beside it."""
    under = min(room.width() - around.width(), (_MOST_HIGH * room.height() - around.height()) / tall)
    beside = min(_MOST_WIDE * room.width() - around.width(), (room.height() - around.height()) / tall)
    return under, beside


def _around(column: StageColumn) -> QSize:
    """What a column has besides its picture."""
    return column.size() - column.view.canvas_size_px
