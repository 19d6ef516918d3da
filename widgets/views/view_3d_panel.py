"""A 3D view with a legend and the name of its frame."""

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtGui import QAction, QTextDocumentFragment
from PyQt6.QtWidgets import (
    QGridLayout,
    QLabel,
    QMenu,
    QToolButton,
    QWidget,
)

from widgets.style.base import FIXED, YIELDS, EventListener, FixedSizeLabel
from widgets.style.styling import fill, make_command_button, make_icon_button, make_row, set_spacing
from widgets.views.view_3d import View3D

_BELOW = Qt.AlignmentFlag.AlignBottom


class View3DPanel(QWidget):
    """`view` with `legend`, or `under` in its place, and `caption` along its lower edge."""

    def __init__(self, under: QWidget | None = None) -> None:
        super().__init__()
        self.view = View3D()
        self.legend = FixedSizeLabel()
        self.caption = FittingLabel()
        for label in (self.legend, self.caption):
            label.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        line = make_row(8, around_px=(4, 0, 4, 2))
        self._grid = set_spacing(QGridLayout(self), 0)
        self._grid.addWidget(self.view, 0, 0)
        self._grid.addLayout(fill(line, (under or self.legend, 1), (self.caption, 1)), 0, 0, _BELOW)


class ScenePanel(View3DPanel):
    """The view of both sensors, with buttons in its upper left corner and a menu."""

    def __init__(self) -> None:
        self.sensors = FittingLabel(Qt.AlignmentFlag.AlignLeft)
        super().__init__(self.sensors)
        self.view.keys = frozenset({Qt.Key.Key_Space})
        self.view.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.view.setAccessibleName("both sensors and the object")
        self._tools = make_row(0)
        corner = Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft
        self._grid.addLayout(self._tools, 0, 0, corner)

    def offer(self, motion: QAction, menu: QMenu) -> None:
        """Offer the motion and the menu of the scene."""
        views = make_icon_button("sliders", "scene_menu", "Views and tools of the scene")
        views.setMenu(menu)
        views.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        fill(self._tools, make_command_button(motion), views)
        self.view.menu_requested.connect(menu.popup)


class FittingLabel(QLabel):
    """One line of rich text: the longest of several versions that fits."""

    def __init__(self, side: Qt.AlignmentFlag = Qt.AlignmentFlag.AlignRight) -> None:
        super().__init__()
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setSizePolicy(YIELDS, FIXED)
        self.setAlignment(side | Qt.AlignmentFlag.AlignVCenter)
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
        for telling, width in zip(self._tellings, self._widths, strict=True):
            self.setText(telling)  # the last one where none fits
            if width <= self.width():
                break
