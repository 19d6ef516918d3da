"""A 3D view with what belongs under it: a legend or the slider of kept states, and whose frame it is drawn in."""

from __future__ import annotations

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel, QSizePolicy, QVBoxLayout, QWidget

from widgets.looks import smaller, spaced
from widgets.solid_view import SolidView


class SolidCell(QWidget):
    """`view` over `legend`, or over `under` in its place, over `caption`."""

    def __init__(self, under: QWidget | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.view, self.legend, self.caption = SolidView(), _small(), _small()
        layout = spaced(QVBoxLayout(self), 0)
        layout.addWidget(self.view, 1)
        for widget in (self.legend if under is None else under, self.caption):
            layout.addWidget(widget)

    def height_px(self, tall: float) -> int:
        """How high it is with a view of this height in widths."""
        return self.height() - self.view.height() + round(tall * self.view.width())


def _small() -> QLabel:
    label = QLabel()
    smaller(label)
    label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
    label.setAlignment(Qt.AlignmentFlag.AlignHCenter)
    return label
