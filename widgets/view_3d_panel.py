"""A 3D view with what belongs under it: a legend or the slider of kept states, and whose frame it is drawn in."""

from __future__ import annotations

from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel, QSizePolicy, QVBoxLayout, QWidget

from widgets.fixed_size_label import FixedSizeLabel
from widgets.styling import set_spacing, shrink_font
from widgets.view_3d import View3D


class View3DPanel(QWidget):
    """`view` over `legend`, or over `under` in its place, over `caption`."""

    def __init__(self, under: QWidget | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.view, self.legend, self.caption = View3D(), FixedSizeLabel(), FittingLabel()
        shrink_font(self.legend)
        self.legend.setAlignment(Qt.AlignmentFlag.AlignHCenter)
        layout = set_spacing(QVBoxLayout(self), 0)
        layout.addWidget(self.view, 1)
        for widget in (self.legend if under is None else under, self.caption):
            layout.addWidget(widget)

    def compute_height_px(self, tall: float) -> int:
        """How high it is with a view of this height in widths."""
        return self.height() - self.view.height() + round(tall * self.view.width())


class FittingLabel(QLabel):
    """One line of rich text: the longest of several tellings of the same for which there is room."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        shrink_font(self)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAlignment(Qt.AlignmentFlag.AlignHCenter)
        self._tellings: tuple[str, ...] = ()
        self._widths: list[int] = []

    def set_texts(self, *tellings: str) -> None:
        """These from now on, the longest first; that one is its tip."""
        if tellings != self._tellings:
            self._tellings = tellings
            self._widths = [self._width(telling) for telling in tellings]
            self.setToolTip(tellings[0])
            self._fit()

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Other room, another telling."""
        super().resizeEvent(a0)
        self._fit()

    def _width(self, telling: str) -> int:
        self.setText(telling)
        return self.sizeHint().width()

    def _fit(self) -> None:
        fitting = [t for t, width in zip(self._tellings, self._widths, strict=True) if width <= self.width()]
        if self._tellings:
            self.setText((fitting or self._tellings[-1:])[0])
