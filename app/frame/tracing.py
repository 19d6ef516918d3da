"""The traced pixel: crosshairs in the pictures, dots in 3D, a sentence below."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from PyQt6.QtCore import QObject, QTimer, pyqtSignal

from app.frame.window import Window
from app.session.state import DisplayParams
from app.views import solids
from app.views.pictures import CloudPicture
from pipeline.engine.graph import StageResult
from pipeline.translation import trace
from pipeline.translation.routes import STAGES
from pipeline.translation.trace import Mark
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from widgets.layers import Scene

_TITLES = {"source": "source", **{s.name: s.title.lower() for s in STAGES}}
_NOTHING, _NOT_YET = "nothing of the source came to this pixel", "not worked out yet"
_DOTS_AFTER_MS = 40  # 3D follows the mouse at most this often


class Tracer(QObject):
    """Follows the pixel under the mouse, or the pinned one, through whatever was worked out."""

    pinned = pyqtSignal(bool)

    def __init__(self, window: Window) -> None:
        super().__init__(window)
        self._window = window
        self._results: Mapping[str, StageResult] = {}
        self._frame: TactileFrame | None = None
        self._cloud: CloudPicture | None = None
        self._at: tuple[str, int, int] | None = None
        self._frozen = False
        self._scene: Scene | None = None
        self._radius_mm, self._display = 0.5, DisplayParams()
        self._translation: Translation | None = None
        self._marks: tuple[Mark, ...] = ()
        self._dots = QTimer(self)
        self._dots.setSingleShot(True)
        self._dots.setInterval(_DOTS_AFTER_MS)
        self._dots.timeout.connect(self._show_dots)

    def show_results(self, results: Mapping[str, StageResult], frame: TactileFrame | None = None) -> None:
        """Trace through these from now on, of another `frame` if given; the traced pixel is traced anew."""
        self._results, self._frame = results, frame or self._frame
        if self._at is not None:
            self._trace(*self._at)

    def show_cloud(self, cloud: CloudPicture | None) -> None:
        """Which point each pixel of the cloud's picture shows."""
        if cloud is not None:
            self._cloud = cloud

    def show_scene(self, scene: Scene, radius_mm: float, display: DisplayParams, translation: Translation) -> None:
        """Where the dots go, and how far depth is stretched there."""
        self._scene, self._radius_mm, self._display, self._translation = scene, radius_mm, display, translation

    def hover(self, stage: str, row: int, col: int) -> None:
        """The mouse is over a pixel of a picture, or over none (-1, -1)."""
        picture = self._window.columns[stage].view.picture
        text = picture.probe(row, col) if picture is not None and row >= 0 else ""
        self._window.probe.setText(f"{_TITLES[stage]} {text}" if text else "")
        if not self._frozen and row >= 0:
            self._trace(stage, row, col)

    def click(self, stage: str, row: int, col: int) -> None:
        """Pin a pixel; a click on the pinned one lets go."""
        self._frozen = not (self._frozen and self._at == (stage, row, col))
        self._trace(stage, row, col)
        self.pinned.emit(self._frozen)

    def freeze(self, frozen: bool) -> None:
        """Keep the traced pixel where it is."""
        self._frozen = frozen
        if self._at is not None:
            self._trace(*self._at)

    def settle(self) -> None:
        """Put the dots in 3D now instead of soon."""
        self._dots.stop()
        self._show_dots()

    def clear(self) -> None:
        """Trace nothing."""
        self._frozen, self._at, self._marks = False, None, ()
        for column in self._window.columns.values():
            column.view.show_cross(None)
        self._window.trace.show_steps(())
        self._dots.start()
        self.pinned.emit(False)

    def _trace(self, stage: str, row: int, col: int) -> None:
        self._at = (stage, row, col)
        marks = self._marks_of(stage, row, col)
        crosses: dict[str, tuple[int, int] | None] = dict.fromkeys(self._window.columns)
        for mark in marks:
            if mark.row >= 0:
                crosses[mark.stage] = (mark.row, mark.col)
            elif mark.stage == "adapt" and mark.point_mm is not None and self._cloud is not None:
                crosses["adapt"] = self._in_cloud_picture(mark.point_mm)
        crosses["pose"] = crosses["generate"]
        crosses[stage] = (row, col)
        for name, column in self._window.columns.items():
            column.view.show_cross(crosses[name])
        steps = [(_TITLES[m.stage], m.text) for m in marks]
        ending = "" if marks else _NOTHING
        if not self._results or (stage != "source" and stage not in self._results):
            ending = _NOT_YET
        if not marks:
            steps = [(_TITLES[stage], f"({col}, {row})")]
        self._window.trace.show_steps(steps, pinned=self._frozen, ending=ending)
        self._marks = marks
        if not self._dots.isActive():
            self._dots.start()

    def _marks_of(self, stage: str, row: int, col: int) -> tuple[Mark, ...]:
        depth = self._results.get("depth")
        if depth is None or self._frame is None:
            return ()
        rows, cols = depth.output.contact.shape
        if stage == "source":
            high, wide = self._frame.image.shape[:2]
            return trace.forward(self._results, min(row * rows // high, rows - 1), min(col * cols // wide, cols - 1))
        if stage == "depth":
            return trace.forward(self._results, row, col) if row < rows and col < cols else ()
        if stage == "adapt":
            return self._from_cloud_picture(row, col)
        view = self._results.get("project")
        if view is None or row >= view.output.contact.shape[0] or col >= view.output.contact.shape[1]:
            return ()
        return trace.backward(self._results, row, col)

    def _from_cloud_picture(self, row: int, col: int) -> tuple[Mark, ...]:
        cloud = self._results.get("adapt")
        if self._cloud is None or cloud is None or row >= self._cloud.camera.rows or col >= self._cloud.camera.cols:
            return ()
        point = int(self._cloud.point_index[row, col])
        if not 0 <= point < len(cloud.output.source_index):
            return ()
        return trace.forward_from_pixel(self._results, int(cloud.output.source_index[point]))

    def _in_cloud_picture(self, point_mm: tuple[float, float, float]) -> tuple[int, int] | None:
        assert self._cloud is not None
        x_px, y_px, visible = self._cloud.camera.project(np.asarray([point_mm]))
        return (round(float(y_px[0])), round(float(x_px[0]))) if visible[0] else None

    def _show_dots(self) -> None:
        if self._scene is None or self._translation is None:
            return
        dots = solids.trace_dots(self._marks, self._translation, self._display)
        for column, name in enumerate(self._window.columns):
            self._scene.mark(column, dots.get(name), self._radius_mm)
