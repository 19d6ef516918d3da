"""The traced pixel: crosshairs in the pictures, dots in 3D, a sentence below."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from app.window.main_window import MainWindow
from app.window.scene_geometry import compute_trace_points
from pipeline.engine.graph import StageResult
from pipeline.previews.display_params import DisplayParams
from pipeline.stages.stage import GroundTruth, ProbePoint
from pipeline.translation import pixel_trace
from pipeline.translation.translate import Translation
from pipeline.values.frames import TactileFrame
from widgets.scene_renderer import SceneRenderer
from widgets.styling import make_single_shot_timer

_NOTHING, _NOT_YET = "nothing of the source came to this pixel", "not worked out yet"
_DOTS_AFTER_MS = 40  # 3D follows the mouse at most this often


class PixelProbe(QObject):
    """Follows the pixel under the mouse, or the pinned one, through whatever was worked out."""

    pin_changed = pyqtSignal(bool)
    pixel_moved = pyqtSignal(str, int, int)  # by keys, to a column's row and col

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._results: Mapping[str, StageResult] = {}
        self._frame: TactileFrame | None = None
        self._facts = GroundTruth()
        self._at: tuple[str, int, int] | None = None
        self._frozen = False
        self._scene: SceneRenderer | None = None
        self._display = DisplayParams()
        self._translation: Translation | None = None
        self._marks: tuple[ProbePoint, ...] = ()
        self._dots = make_single_shot_timer(self, _DOTS_AFTER_MS, self._show_dots)

    def set_results(
        self, results: Mapping[str, StageResult], frame: TactileFrame | None = None, facts: GroundTruth | None = None
    ) -> None:
        """Trace through these from now on, of another `frame` if given; the traced pixel is traced anew."""
        self._results, self._frame, self._facts = results, frame or self._frame, facts or self._facts
        if self._at is not None:
            self._trace(*self._at)

    def set_scene(self, scene: SceneRenderer, display: DisplayParams, translation: Translation) -> None:
        """Where the dots go, and how far depth is stretched there."""
        self._scene, self._display, self._translation = scene, display, translation

    def probe_pixel(self, column: str, row: int, col: int) -> None:
        """The mouse is over a pixel of a picture, or over none (-1, -1)."""
        picture = self._window.columns[column].view.preview
        text = picture.describe_pixel(row, col) if picture is not None and row >= 0 else ""
        true = self._truth(column, row, col) if text else ""
        ending = f" · truth {true}" if true else ""
        self._window.readout.setText(f"{self._title(column)} {text}{ending}" if text else "")
        if not self._frozen and row >= 0:
            self._trace(column, row, col)

    def toggle_pin(self, column: str, row: int, col: int) -> None:
        """Pin a pixel; a click on the pinned one lets go."""
        self._frozen = not (self._frozen and self._at == (column, row, col))
        self._trace(column, row, col)
        self.pin_changed.emit(self._frozen)

    def move_to_pixel(self, column: str, row: int, col: int) -> None:
        """Trace another pixel, also where one is pinned: then that one is."""
        frozen, self._frozen = self._frozen, False
        self.probe_pixel(column, row, col)
        self._frozen = frozen
        if frozen:
            self._trace(column, row, col)
        self.pixel_moved.emit(column, row, col)

    def set_frozen(self, frozen: bool) -> None:
        """Keep the traced pixel where it is."""
        self._frozen = frozen
        if self._at is not None:
            self._trace(*self._at)

    def draw_pending(self) -> None:
        """Put the dots in 3D now instead of soon."""
        self._dots.stop()
        self._show_dots()

    def clear_trace(self) -> None:
        """Trace nothing."""
        self._frozen, self._at, self._marks = False, None, ()
        for column in self._window.columns.values():
            column.view.show_crosshair(None)
        self._window.trace.show_steps(())
        self._dots.start()
        self.pin_changed.emit(False)

    def _trace(self, column: str, row: int, col: int) -> None:
        picture = self._window.columns[column].view.preview
        if picture is not None and not (row < picture.pixels.shape[0] and col < picture.pixels.shape[1]):
            self.clear_trace()  # pinned in a larger picture, of another sensor
            return
        self._at = (column, row, col)
        marks = self._marks_of(column, row, col)
        crosses: dict[str, tuple[int, int] | None] = dict.fromkeys(self._window.columns)
        for mark in marks:
            crosses[mark.stage] = (mark.row, mark.col) if mark.row >= 0 else self._in_picture(mark)
        crosses[column] = (row, col)
        for name, shown in self._window.columns.items():
            shown.view.show_crosshair(crosses[name], self._reads(name, crosses[name]))
        steps = [(self._title(m.stage), m.text) for m in marks]
        ending = "" if marks else _NOTHING
        if not self._results or (column != pixel_trace.SOURCE and column not in self._results):
            ending = _NOT_YET
        if not marks:
            steps = [(self._title(column), f"({col}, {row})")]
        true = self._last_truth(marks, (column, row, col))
        if true:
            steps.append(("truth", true))
        self._window.trace.show_steps(steps, pinned=self._frozen, ending=ending, is_waiting=ending == _NOT_YET)
        self._marks = marks
        if not self._dots.isActive():
            self._dots.start()

    def _reads(self, column: str, pixel: tuple[int, int] | None) -> str:
        """What a column's picture reads at the crosshair."""
        picture = self._window.columns[column].view.preview
        return picture.format_value(*pixel) if picture is not None and pixel is not None else ""

    def _last_truth(self, marks: tuple[ProbePoint, ...], at: tuple[str, int, int]) -> str:
        """The truth where the trace ends, or where it was asked for if it leads nowhere."""
        ends = [(mark.stage, mark.row, mark.col) for mark in marks if mark.row >= 0] or [at]
        return next((true for end in reversed(ends) if (true := self._truth(*end))), "")

    def _truth(self, column: str, row: int, col: int) -> str:
        known = self._translation
        return "" if known is None else pixel_trace.describe_truth(column, row, col, self._facts, known.catalogue)

    def _marks_of(self, column: str, row: int, col: int) -> tuple[ProbePoint, ...]:
        picture = self._window.columns[column].view.preview
        if self._translation is None or self._frame is None or picture is None:
            return ()
        rows, cols = picture.pixels.shape[:2]
        if not (0 <= row < rows and 0 <= col < cols):
            return ()
        index = row * cols + col if picture.element_index is None else int(picture.element_index[row, col])
        catalogue, wide = self._translation.catalogue, self._frame.image.shape[1]
        pixel = pixel_trace.trace_to_source(self._results, column, index, catalogue)
        return pixel_trace.trace_forward(self._results, *divmod(pixel, wide), wide, catalogue) if pixel >= 0 else ()

    def _in_picture(self, mark: ProbePoint) -> tuple[int, int] | None:
        """Where a point is in its column's picture, which has no pixel for each element."""
        picture = self._window.columns[mark.stage].view.preview
        if mark.point_mm is None or picture is None or picture.camera is None:
            return None
        x_px, y_px, visible = picture.camera.project(np.asarray([mark.point_mm]))
        return (round(float(y_px[0])), round(float(x_px[0]))) if visible[0] else None

    def _title(self, column: str) -> str:
        if column == pixel_trace.SOURCE or self._translation is None:
            return pixel_trace.SOURCE
        return self._translation.catalogue.stage(column).title.lower()

    def _show_dots(self) -> None:
        if self._scene is None or self._translation is None:
            return
        found = compute_trace_points(self._marks, self._translation, self._display)
        for column, name in enumerate(self._window.columns):
            self._scene.mark_point(column, found.get(name))
