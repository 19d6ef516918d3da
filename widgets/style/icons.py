"""Icons in the colours of the current palette: signs of stage states, and commands, from
`widgets/style/drawings`.
"""

from functools import lru_cache
from pathlib import Path

from PyQt6.QtCore import QByteArray, QRect, QRectF, QSize, Qt
from PyQt6.QtGui import QGuiApplication, QIcon, QIconEngine, QPainter, QPalette, QPixmap
from PyQt6.QtSvg import QSvgRenderer

from pipeline.views.colours import Rgb
from widgets.style.base import PaintedWidget
from widgets.style.theme import ThemeColours, get_theme_colours, to_hex

# one SVG per icon, in currentColor; `state_*` are signs of states
DRAWINGS = Path(__file__).with_name("drawings")
PENDING = ("stale", "running")  # states of a stage that is being computed again
_FAINT = 0.35  # opacity of a disabled command


def make_command_icon(name: str) -> QIcon:
    """Return the icon of a command."""
    return QIcon(_Engine(name))


def make_state_icon(state: str) -> QIcon:
    """Return the sign of a state, for tables."""
    return QIcon(_Engine(state, is_state=True))


def paint_state(painter: QPainter, room: QRectF, state: str, palette: QPalette) -> None:
    """Paint the round sign of a stage's state; states differ by their mark, not by colour alone."""
    _load_drawing(f"state_{state}", get_theme_colours(palette).states[state]).render(painter, room)


def is_trouble(state: str) -> bool:
    """Return whether a state needs attention, and so a sign."""
    return state in ("warning", "failed")


class StateIcon(PaintedWidget):
    """The sign of a state; keeps its room while there is none."""

    def __init__(self, size_px: int = 16) -> None:
        super().__init__()
        self.state = ""
        self.setFixedSize(size_px, size_px)

    def show_state(self, state: str) -> None:
        """Show another sign; "" for none."""
        if state != self.state:
            self.state = state
            self.setAccessibleName(state)
            self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint the sign."""
        del ink
        if self.state:
            paint_state(painter, QRectF(self.rect()), self.state, self.palette())


class _Engine(QIconEngine):
    """Icon engine that paints on request, so that an icon follows theme and screen density."""

    def __init__(self, name: str, *, is_state: bool = False) -> None:
        super().__init__()
        self._name = name
        self._is_state = is_state

    def clone(self) -> QIconEngine:
        return _Engine(self._name, is_state=self._is_state)

    def pixmap(self, size: QSize, mode: QIcon.Mode, state: QIcon.State) -> QPixmap:
        pixmap = QPixmap(size)
        pixmap.fill(Qt.GlobalColor.transparent)
        painter = QPainter(pixmap)
        self.paint(painter, QRect(0, 0, size.width(), size.height()), mode, state)
        painter.end()
        return pixmap

    def paint(
        self, painter: QPainter | None, rect: QRect, mode: QIcon.Mode, state: QIcon.State
    ) -> None:
        del state
        if painter is None:
            return
        palette = QGuiApplication.palette()
        if self._is_state:
            paint_state(painter, QRectF(rect), self._name, palette)
            return
        painter.save()
        painter.setOpacity(_FAINT if mode == QIcon.Mode.Disabled else 1.0)
        _load_drawing(self._name, get_theme_colours(palette).icon).render(painter, QRectF(rect))
        painter.restore()


@lru_cache
def _load_drawing(name: str, colour: Rgb) -> QSvgRenderer:
    text = (DRAWINGS / f"{name}.svg").read_text("utf-8").replace("currentColor", to_hex(colour))
    renderer = QSvgRenderer(QByteArray(text.encode()))
    renderer.setAspectRatioMode(Qt.AspectRatioMode.KeepAspectRatio)
    return renderer
