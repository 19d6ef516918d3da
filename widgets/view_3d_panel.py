"""A 3D view with a legend or a step slider, and the name of its frame."""

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtGui import QTextDocumentFragment
from PyQt6.QtWidgets import QLabel, QSizePolicy, QVBoxLayout, QWidget

from widgets.base import EventListener, FixedSizeLabel, resize_font
from widgets.styling import fill, set_spacing
from widgets.view_3d import View3D


class View3DPanel(QWidget):
    """`view` over `legend`, or over `under` in its place, over `caption`."""

    def __init__(self, under: QWidget | None = None) -> None:
        super().__init__()
        self.view, self.legend, self.caption = View3D(), FixedSizeLabel(), FittingLabel()
        resize_font(self.legend)
        self.legend.setAlignment(Qt.AlignmentFlag.AlignHCenter)
        fill(set_spacing(QVBoxLayout(self), 0), (self.view, 1), under or self.legend, self.caption)

    def compute_height_px(self, tall: float) -> int:
        """Return the height with a view of `tall` widths."""
        return self.height() - self.view.height() + round(tall * self.view.width())


class FittingLabel(QLabel):
    """One line of rich text: the longest of several versions that fits."""

    def __init__(self) -> None:
        super().__init__()
        self.setTextFormat(Qt.TextFormat.RichText)
        resize_font(self)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setAlignment(Qt.AlignmentFlag.AlignHCenter)
        self._tellings: tuple[str, ...] = ()
        self._widths: list[int] = []
        EventListener(self, self._fit, QEvent.Type.Resize)

    def set_texts(self, *tellings: str) -> None:
        """Set the versions, the longest first; that one is the tooltip, without markup."""
        if tellings != self._tellings:
            self._tellings = tellings
            self._widths = [self._width(telling) for telling in tellings]
            self.setToolTip(QTextDocumentFragment.fromHtml(tellings[0]).toPlainText())
            self._fit()

    def _width(self, telling: str) -> int:
        self.setText(telling)
        return self.sizeHint().width()

    def _fit(self) -> None:
        fitting = [t for t, width in zip(self._tellings, self._widths, strict=True) if width <= self.width()]
        if self._tellings:
            self.setText((fitting or self._tellings[-1:])[0])
