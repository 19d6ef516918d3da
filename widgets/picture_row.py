"""Pictures over 3D views: the upper row is as high as its pictures need at the width they have."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, QObject, Qt
from PyQt6.QtGui import QResizeEvent
from PyQt6.QtWidgets import QHBoxLayout, QSplitter, QWidget

from widgets.looks import once, spaced
from widgets.stage_column import StageColumn

_LEAST_BELOW = 0.3  # of the height that is left to what stands below


class PictureRow(QSplitter):
    """A row of columns over one widget; follows the pictures until somebody drags the handle."""

    def __init__(self, columns: Sequence[StageColumn], below: QWidget) -> None:
        super().__init__(Qt.Orientation.Vertical)
        self._columns, self._dragged = tuple(columns), False
        above = QWidget()
        row = spaced(QHBoxLayout(above), 2)
        for column in columns:
            row.addWidget(column, 1)
            column.view.shape_changed.connect(self._fit_soon)
            for seen in (column, column.view):  # the latter also where a note takes room from it
                seen.installEventFilter(self)
        self.addWidget(above)
        self.addWidget(below)
        self.setChildrenCollapsible(False)
        self._soon = once(self, 0, self.fit)
        self.splitterMoved.connect(self._keep)

    def fit(self) -> None:
        """Share the height out by what the pictures need, where nobody chose another share."""
        shown = [column for column in self._columns if column.isVisibleTo(self)]
        if self._dragged or not shown:
            return
        room = self.height() - self.handleWidth()
        above = min(max(column.wanted_height_px() for column in shown), round((1.0 - _LEAST_BELOW) * room))
        if abs(self.sizes()[0] - above) > 1:
            self.setSizes([above, room - above])

    def resizeEvent(self, a0: QResizeEvent | None) -> None:  # noqa: N802
        """Other widths need other heights."""
        super().resizeEvent(a0)
        self._fit_soon()

    def eventFilter(self, a0: QObject | None, a1: QEvent | None) -> bool:  # noqa: N802
        """A column that comes, goes or gets another width changes what all need."""
        if a1 is not None and a1.type() in (QEvent.Type.Show, QEvent.Type.Hide, QEvent.Type.Resize):
            self._fit_soon()
        return super().eventFilter(a0, a1)

    def _fit_soon(self) -> None:
        self._soon.start()

    def _keep(self) -> None:
        self._dragged = True
