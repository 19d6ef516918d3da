"""The row of 3D views: one OpenGL widget with a sub-view per stage, drawn only when Qt asks it to paint."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtGui import QGuiApplication, QImage, QOffscreenSurface, QOpenGLContext, QPixmap, QResizeEvent
from PyQt6.QtWidgets import QLabel, QSizePolicy, QWidget
from pyvistaqt import QtInteractor

from pipeline.base.arrays import Doubles
from widgets.colours import BACKDROP
from widgets.layers import Layer, Scene, Sight
from widgets.sub_views import SubViews

_TOGETHER_MS = 30


class LiveScene(QtInteractor):  # pyright: ignore[reportUntypedBaseClass]
    """All sub-views in one OpenGL widget; `update()` only, never `render()` (two renders for one)."""

    def __init__(self, columns: int, parent: QWidget | None = None) -> None:
        super().__init__(parent, auto_update=False, multi_samples=_samples(), shape=(1, columns), border=False)
        self.suppress_rendering = True
        self.setAcceptDrops(False)  # the window takes them
        for renderer in self.renderers:
            renderer.set_background([c / 255 for c in BACKDROP])
        self._stage = SubViews(self, columns)
        self._soon = QTimer(self)
        self._soon.setSingleShot(True)
        self._soon.setInterval(_TOGETHER_MS)
        self._soon.timeout.connect(self.update)

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
        self._stage.fit(self.width(), self.height())
        self._draw_soon()

    def settle(self) -> None:
        """Draw now what was going to be drawn soon."""
        self._soon.stop()
        self.update()

    def finish(self) -> None:
        """Close the OpenGL widget."""
        self._soon.stop()
        self.close()

    def resizeEvent(self, e: Any) -> None:  # noqa: N802
        """Fit the views to the new size."""
        super().resizeEvent(e)
        if hasattr(self, "_stage"):  # Qt sizes the widget before it is built
            self._stage.fit(self.width(), self.height())

    def _draw_soon(self) -> None:
        """Stages arrive one by one within a few milliseconds: one picture serves them all."""
        if not self._soon.isActive():
            self._soon.start()

    def widget(self) -> QWidget:
        """Itself."""
        return self


class PicturedScene(QLabel):
    """The same sub-views as a picture drawn off screen, for machines where a window gets no OpenGL."""

    def __init__(self, columns: int, parent: QWidget | None = None) -> None:
        super().__init__("3D needs OpenGL, which this display does not offer", parent)
        self.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.setMinimumSize(60, 60)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Ignored)  # the picture follows the room
        self._plotter: Any = None
        self._soon = QTimer(self)
        self._soon.setSingleShot(True)
        self._soon.setInterval(_TOGETHER_MS)
        self._soon.timeout.connect(self._draw)
        try:
            self._plotter = pv.Plotter(off_screen=True, shape=(1, columns), border=False)
            self._plotter.background_color = [c / 255 for c in BACKDROP]
            self._stage = SubViews(self._plotter, columns)
        except Exception as error:  # noqa: BLE001 - VTK raises what its back end raises; the notice stays instead
            self._plotter = None
            self.setToolTip(str(error))

    def show_layers(self, column: int, layers: Sequence[Layer]) -> None:
        """Show exactly these layers in a sub-view."""
        if self._plotter is not None and self._stage.show(column, layers):
            self._soon.start()

    def place(self, column: int, name: str, placed: Doubles) -> None:
        """Move one layer as a whole."""
        if self._plotter is not None:
            self._stage.place(column, name, placed)
            self._soon.start()

    def look(self, sights: Mapping[int, Sight], *, linked: bool) -> None:
        """Set the cameras."""
        if self._plotter is not None:
            self._stage.look(sights, linked)
            self._soon.start()

    def mark(self, column: int, place_mm: tuple[float, float, float] | None, radius_mm: float) -> None:
        """Put the traced pixel's dot into a sub-view, or take it away."""
        if self._plotter is not None and self._stage.mark(column, place_mm, radius_mm):
            self._soon.start()

    def show_columns(self, visible: Sequence[int]) -> None:
        """Give the room to these sub-views."""
        if self._plotter is not None:
            self._stage.show_columns(visible)
            self._stage.fit(self.width(), self.height())
            self._soon.start()

    def settle(self) -> None:
        """Draw now what was going to be drawn soon."""
        if self._soon.isActive():
            self._soon.stop()
            self._draw()

    def finish(self) -> None:
        """Close the plotter."""
        self._soon.stop()
        if self._plotter is not None:
            self._plotter.close()

    def widget(self) -> QWidget:
        """Itself."""
        return self

    def resizeEvent(self, a0: QResizeEvent | None) -> None:  # noqa: N802
        """Draw at the new size."""
        super().resizeEvent(a0)
        if self._plotter is not None:
            self._stage.fit(self.width(), self.height())
            self._soon.start()

    def _draw(self) -> None:
        """One picture of everything."""
        size = self.size()
        self._plotter.window_size = [max(60, size.width()), max(60, size.height())]
        pixels = np.ascontiguousarray(self._plotter.screenshot(return_img=True))
        rows, cols = pixels.shape[:2]
        image = QImage(pixels.tobytes(), cols, rows, 3 * cols, QImage.Format.Format_RGB888)
        self.setPixmap(QPixmap.fromImage(image))


def _samples() -> int:
    """Samples a pixel: smoothing doubles the time of a picture where a processor draws it."""
    devices = [*Path("/dev").glob("dri/*"), *Path("/dev").glob("nvidia*")]
    return 0 if sys.platform == "linux" and not devices else 4


def best_scene(columns: int, parent: QWidget | None = None) -> Scene:
    """A live scene, or a pictured one where a window gets no OpenGL."""
    if not _opengl_works():
        return PicturedScene(columns, parent)
    try:
        return LiveScene(columns, parent)
    except Exception:  # noqa: BLE001 - drivers fail in their own ways; the rest of the window must work
        return PicturedScene(columns, parent)


def _opengl_works() -> bool:
    """Asked beforehand: a widget without a context stays empty instead of failing."""
    if QGuiApplication.platformName() in ("offscreen", "minimal"):
        return False
    surface, context = QOffscreenSurface(), QOpenGLContext()
    surface.create()
    works = context.create() and context.makeCurrent(surface)
    context.doneCurrent()
    return bool(works)
