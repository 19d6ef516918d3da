"""The row of 3D views: one picture with a sub-view per stage, drawn off screen once for all that changed."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QImage, QMouseEvent, QPainter, QPaintEvent, QResizeEvent, QWheelEvent
from PyQt6.QtWidgets import QSizePolicy
from vtkmodules.vtkInteractionStyle import vtkInteractorStyleTrackballCamera
from vtkmodules.vtkRenderingUI import vtkGenericRenderWindowInteractor

from pipeline.base.arrays import Doubles
from pipeline.pictures.layers import Layer, Sight
from widgets.colours import BACKDROP, qcolor
from widgets.layers import Scene
from widgets.looks import once
from widgets.sub_views import SubViews

_TOGETHER_MS = 30  # stages arrive one by one within a few milliseconds: one picture serves them all
_ONE_TURN = 120  # eighths of a degree, as Qt counts what a wheel goes on by
_BUTTONS = {
    Qt.MouseButton.LeftButton: "LeftButton",  # turns
    Qt.MouseButton.MiddleButton: "MiddleButton",  # shifts
    Qt.MouseButton.RightButton: "RightButton",  # nears
}


class LiveScene(Scene):
    """All sub-views as one picture, turned with the mouse.

    An OpenGL widget would make Qt build the whole window anew once it comes, and compose every later repaint in
    OpenGL, which costs most where there is no graphics card; reading the picture back costs a millisecond.
    """

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.setMinimumSize(60, 60)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Ignored)  # the picture follows the room
        self._stage = SubViews(columns, _samples())
        self.renderers: Sequence[Any] = self._stage.renderers
        self._mouse: Any = vtkGenericRenderWindowInteractor()
        self._mouse.SetRenderWindow(self._stage.window)
        self._mouse.SetInteractorStyle(vtkInteractorStyleTrackballCamera())
        self._mouse.EnableRenderOff()  # drawn together with everything else
        self._mouse.Initialize()
        self._image: QImage | None = None
        self._finished, self._turned = False, 0
        self._soon = once(self, _TOGETHER_MS, self._draw)

    def show_layers(self, column: int, layers: Sequence[Layer]) -> None:
        """Show exactly these layers in a sub-view."""
        if self._stage.show(column, layers):
            self._draw_soon()

    def place(self, column: int, name: str, placed: Doubles) -> None:
        """Move one layer as a whole."""
        self._stage.place(column, name, placed)
        self._draw_soon()

    def look(self, sights: Mapping[int, Sight], *, linked: bool) -> None:
        """Set the cameras; views of one frame share theirs when `linked`."""
        self._stage.look(sights, linked)
        self._draw_soon()

    def mark(self, column: int, place_mm: tuple[float, float, float] | None, radius_mm: float) -> None:
        """Put the traced pixel's dot into a sub-view, or take it away."""
        if self._stage.mark(column, place_mm, radius_mm):
            self._draw_soon()

    def show_columns(self, visible: Sequence[int]) -> None:
        """Give the room to these sub-views, in equal shares."""
        self._stage.show_columns(visible)
        self._draw_soon()

    def settle(self) -> None:
        """Draw now what was going to be drawn soon."""
        if self._soon.isActive():
            self._draw()

    def finish(self) -> None:
        """Let go of everything OpenGL; the last picture stays."""
        self._soon.stop()
        self._finished = True  # a late change of size would open OpenGL again
        self._stage.close()

    def paintEvent(self, a0: QPaintEvent | None) -> None:  # noqa: N802
        """The last picture, or the backdrop until there is one."""
        del a0
        painter = QPainter(self)
        painter.fillRect(self.rect(), qcolor(BACKDROP))
        if self._image is not None:
            painter.drawImage(self.rect(), self._image)

    def resizeEvent(self, a0: QResizeEvent | None) -> None:  # noqa: N802
        """Draw at the new size."""
        super().resizeEvent(a0)
        self._draw_soon()

    def mousePressEvent(self, ev: QMouseEvent | None) -> None:  # noqa: N802
        """Take hold of a view."""
        self._button(ev, "PressEvent")

    def mouseReleaseEvent(self, ev: QMouseEvent | None) -> None:  # noqa: N802
        """Let go of it."""
        self._button(ev, "ReleaseEvent")

    def mouseMoveEvent(self, ev: QMouseEvent | None) -> None:  # noqa: N802
        """Turn, shift or near it; Qt tells of motion only while a button is down."""
        if ev is not None:
            self._tell(ev, "MouseMoveEvent")

    def wheelEvent(self, a0: QWheelEvent | None) -> None:  # noqa: N802
        """Go nearer or farther; a touch pad tells of many small turns that make up one of a wheel."""
        if a0 is None:
            return
        self._turned += a0.angleDelta().y()
        if abs(self._turned) >= _ONE_TURN:
            self._tell(a0, f"MouseWheel{'Forward' if self._turned > 0 else 'Backward'}Event")
            self._turned = 0

    def _button(self, event: QMouseEvent | None, what: str) -> None:
        if event is not None and event.button() in _BUTTONS:
            self._tell(event, _BUTTONS[event.button()] + what)

    def _tell(self, event: QMouseEvent | QWheelEvent, what: str) -> None:
        """Pass on to VTK, in the pixels of its picture."""
        place, scale = event.position(), self.devicePixelRatioF()
        keys = Qt.KeyboardModifier
        control, shift = (bool(event.modifiers() & key) for key in (keys.ControlModifier, keys.ShiftModifier))
        x, y = round(place.x() * scale), round(place.y() * scale)
        self._mouse.SetEventInformationFlipY(x, y, control, shift, chr(0), 0, None)
        self._mouse.InvokeEvent(what)
        self._draw_soon()

    def _draw_soon(self) -> None:
        if not self._finished and not self._soon.isActive():
            self._soon.start()

    def _draw(self) -> None:
        self._soon.stop()
        scale = self.devicePixelRatioF()
        pixels = self._stage.pixels(max(1, round(scale * self.width())), max(1, round(scale * self.height())))
        rows, cols = pixels.shape[:2]
        self._mouse.SetSize(cols, rows)
        self._image = QImage(pixels.tobytes(), cols, rows, 3 * cols, QImage.Format.Format_RGB888).copy()
        self.update()


def _samples() -> int:
    """Samples a pixel: smoothing doubles the time of a picture where a processor draws it."""
    devices = [*Path("/dev").glob("dri/*"), *Path("/dev").glob("nvidia*")]
    return 0 if sys.platform == "linux" and not devices else 4


def best_scene(columns: int) -> Scene:
    """A live scene, or a notice where nothing can be drawn in 3D."""
    try:
        return LiveScene(columns)
    except Exception as error:  # noqa: BLE001 - drivers fail in their own ways; the rest of the window must work
        return Scene(f"3D needs OpenGL, which this machine does not offer ({error})")
