"""Row of previews over a row of 3D views; both are as high as their content needs at its width."""

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, QObject, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QWidget

from widgets.stages.stage_column import StageColumn
from widgets.style.base import EventListener
from widgets.style.styling import FittingSplitter, set_spacing
from widgets.views.view_3d_panel import View3DPanel

_SHORT_PX = 420  # a lower row gives a caption one line, and the state none
_LEAST_BELOW = 0.3  # minimum share of the remaining height for the lower row
_TALL_BELOW = 1.15  # maximum height of a 3D view in widths: beyond it there is only background


class StageRows(FittingSplitter):
    """A row of columns over a row of cells; fits the previews until the user drags the handle.

    `spare_height_changed` carries the height in pixels beyond what is needed; negative if there is
    too little.
    """

    spare_height_changed = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__()
        self._columns: tuple[StageColumn, ...] = ()
        self._cells: tuple[View3DPanel, ...] = ()
        self._watched: set[QObject] = set()
        self._told = False, False, True  # compact captions, states next to titles, room for scales
        self.setObjectName("split_rows")
        self._above = QWidget()
        self.lower_row = QWidget()
        self._upper, self._lower = (
            set_spacing(QHBoxLayout(self._above), 2),
            set_spacing(QHBoxLayout(self.lower_row), 2),
        )
        self.addWidget(self._above)
        self.addWidget(self.lower_row)

    def set_columns(
        self, pairs: Sequence[tuple[StageColumn, View3DPanel]], *, wide: bool = False
    ) -> None:
        """Show these columns and cells in this order; their own visibility decides which are seen.

        `wide` where few are visible, so that each has room next to its title.
        """
        self._columns = tuple(column for column, _ in pairs)
        self._cells = tuple(cell for _, cell in pairs)
        for column, cell in pairs:
            column.set_wide(wide)
            self._upper.addWidget(column, 1)
            self._lower.addWidget(cell, 1)
            for seen in (column, column.view):  # the view too, because a note takes room from it
                if seen not in self._watched:
                    self._watched.add(seen)
                    EventListener(
                        seen,
                        self._soon.start,
                        QEvent.Type.Show,
                        QEvent.Type.Hide,
                        QEvent.Type.Resize,
                    )
                    if seen is column.view:
                        column.view.shape_changed.connect(self._soon.start)
                        column.view.scale_changed.connect(self._soon.start)
        self._soon.start()

    def fit_sizes(self) -> None:
        """Share the height by what the previews need, unless the user set it."""
        here = [column for column in self._columns if column.parentWidget() is self._above]
        shown = [column for column in here if column.isVisibleTo(self)]
        some = any(column.view.has_colour_scale or column.view.preview is None for column in shown)
        short = self.height() < _SHORT_PX
        joined = short and all(column.has_room_for_state for column in shown)
        for column in shown:  # all columns reserve room for scales, or none: previews stay aligned
            column.view.colour_bar.setVisible(some)
            column.set_compact(short, joined=joined)
        pinned_px = max((column.pinned.needed_height_px for column in shown), default=0)
        for column in shown:
            column.pinned.reserve_height(pinned_px)
        if (short, joined, some) != self._told:
            self._told = short, joined, some
            self._soon.start()  # again after the layout
        room = self.height() - self.handleWidth()
        if self.is_user_sized or not shown or self.lower_row.isHidden():
            return
        wanted = max(column.compute_preferred_height_px() for column in shown)
        above = min(wanted, round((1.0 - _LEAST_BELOW) * room))
        if abs(self.sizes()[0] - above) > 1:
            self.setSizes([above, room - above])
        below = [
            cell.compute_height_px(_TALL_BELOW) for cell in self._cells if cell.isVisibleTo(self)
        ]
        self.spare_height_changed.emit(room - wanted - max(below, default=0))
