"""An image and its 3D view in one pane: stacked, or side by side where that makes the image larger."""

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtWidgets import QWidget

from widgets.stage_column import StageColumn
from widgets.styling import FittingSplitter
from widgets.view_3d_panel import View3DPanel

_MOST_HIGH = 0.74  # largest share of a pane's height for the image when stacked
_LEAST_WIDE, _MOST_WIDE = 0.45, 0.66  # limits of its share of the width when side by side
_USUAL_TALL = 0.78  # rows over columns for the layout: all panes use the same one
_WORTH, _STILL = 1.15, 1.08  # gain in image size that switches to side by side, and back
_WAY = Qt.Orientation


class PaneSplitter(FittingSplitter):
    """Fits the image."""

    def __init__(self) -> None:
        super().__init__()
        self._held: tuple[StageColumn, View3DPanel] | None = None

    def set_contents(self, column: StageColumn, cell: View3DPanel) -> None:
        """Show these widgets; the previous ones must have been released."""
        self.is_user_sized = False
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
        if self._held is None or self.is_user_sized or not all(_is_shown_in(widget, self) for widget in self._held):
            return
        column, _ = self._held
        around, room = _around(column), self.size() - QSize(self.handleWidth(), self.handleWidth())
        under, at_side = _wide(room, around, _USUAL_TALL)
        stands = self.orientation() == _WAY.Vertical
        if at_side > _WORTH * under if stands else at_side < _STILL * under:
            self.setOrientation(_WAY.Horizontal if stands else _WAY.Vertical)
            stands = not stands
        tall = column.view.height_over_width
        under, at_side = _wide(room, around, tall)
        if stands:
            whole, first = room.height(), round(around.height() + tall * under)
        else:
            whole, first = room.width(), round(max(_LEAST_WIDE * room.width(), around.width() + at_side))
        if abs(self.sizes()[0] - first) > 1:
            self.setSizes([first, whole - first])


def _is_shown_in(widget: QWidget, by: QWidget) -> bool:
    return widget.parentWidget() is by and widget.isVisibleTo(by)


def _wide(room: QSize, around: QSize, tall: float) -> tuple[float, float]:
    """Return the image width stacked over the 3D view, and next to it."""
    under = min(room.width() - around.width(), (_MOST_HIGH * room.height() - around.height()) / tall)
    at_side = min(_MOST_WIDE * room.width() - around.width(), (room.height() - around.height()) / tall)
    return under, at_side


def _around(column: StageColumn) -> QSize:
    """Return the size of a column without its image."""
    return column.size() - column.view.canvas.size()
