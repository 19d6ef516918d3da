"""A picture and its 3D view in one pane: below each other, or side by side where that leaves the picture larger."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QSplitter, QWidget

from widgets.looks import once
from widgets.solid_cell import SolidCell
from widgets.stage_column import StageColumn

_MOST_HIGH = 0.74  # of a pane's height that the picture has at most, where both stand below each other
_LEAST_WIDE, _MOST_WIDE = 0.45, 0.66  # of its width, where they stand side by side
_USUAL_TALL = 0.78  # rows over columns: all panes are arranged alike, whatever they show
_WORTH, _STILL = 1.15, 1.08  # as much larger the picture is side by side before they change places, and before back
_WAY = Qt.Orientation


class PaneSplit(QSplitter):
    """Follows the picture until somebody drags the handle."""

    def __init__(self) -> None:
        super().__init__(_WAY.Vertical)
        self.setChildrenCollapsible(False)
        self.dragged = False  # from then on both keep their share
        self._held: tuple[StageColumn, SolidCell] | None = None
        self._soon = once(self, 0, self.fit)
        self.splitterMoved.connect(self._keep)

    def hold(self, column: StageColumn, cell: SolidCell) -> None:
        """Show these; what was held before must have been taken elsewhere."""
        self.dragged = False
        for widget in (column, cell):
            self.addWidget(widget)
        column.view.shape_changed.connect(self._soon.start)
        self._held = column, cell
        self._soon.start()

    def let_go(self) -> None:
        """What is held is about to be taken elsewhere."""
        if self._held is not None:
            self._held[0].view.shape_changed.disconnect(self._soon.start)
        self._held = None

    def take_sizes(self, sizes: Sequence[int]) -> None:
        """Stand as somebody dragged it once; without sizes, follow the picture again."""
        self.dragged = len(sizes) == self.count()
        if self.dragged:
            self.setSizes(list(sizes))
        else:
            self._soon.start()

    def fit(self) -> None:
        """Share the room out so that the picture is largest, where nobody chose another share."""
        if self._held is None or self.dragged or not all(_seen(widget, self) for widget in self._held):
            return
        column, _ = self._held
        around, room = _around(column), self.size() - QSize(self.handleWidth(), self.handleWidth())
        under, beside = _wide(room, around, _USUAL_TALL)
        stands = self.orientation() == _WAY.Vertical
        if beside > _WORTH * under if stands else beside < _STILL * under:
            self.setOrientation(_WAY.Horizontal if stands else _WAY.Vertical)
            stands = not stands
        tall = column.view.tall
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
        self.dragged = True


def _seen(widget: QWidget, by: QWidget) -> bool:
    return widget.parentWidget() is by and widget.isVisibleTo(by)


def _wide(room: QSize, around: QSize, tall: float) -> tuple[float, float]:
    """The picture's width over the 3D view, and beside it."""
    under = min(room.width() - around.width(), (_MOST_HIGH * room.height() - around.height()) / tall)
    beside = min(_MOST_WIDE * room.width() - around.width(), (room.height() - around.height()) / tall)
    return under, beside


def _around(column: StageColumn) -> QSize:
    """What a column has besides its picture."""
    return column.size() - column.view.room_px
