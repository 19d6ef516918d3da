"""The probe: one pixel traced through all stages, as crosshairs, 3D points and text."""

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

_NO_SOURCE, _NOT_COMPUTED = "no source pixel maps here", "not computed yet"
_POINTS_DELAY_MS = 40  # shortest interval between updates of the 3D points


class PixelProbe(QObject):
    """Traces the pixel under the mouse, or the pinned one, through the computed stages."""

    pin_changed = pyqtSignal(bool)
    pixel_moved = pyqtSignal(str, int, int)  # by keys: column, row, col

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._results: Mapping[str, StageResult] = {}
        self._frame: TactileFrame | None = None
        self._ground_truth = GroundTruth()
        self._pixel: tuple[str, int, int] | None = None
        self._frozen = False
        self._scene: SceneRenderer | None = None
        self._display = DisplayParams()
        self._translation: Translation | None = None
        self._points: tuple[ProbePoint, ...] = ()
        self._points_timer = make_single_shot_timer(self, _POINTS_DELAY_MS, self._show_points)

    def set_results(
        self,
        results: Mapping[str, StageResult],
        frame: TactileFrame | None = None,
        ground_truth: GroundTruth | None = None,
    ) -> None:
        """Set the results to trace through, and the frame and truth if given; the probed pixel is traced again."""
        self._results, self._frame, self._ground_truth = (
            results,
            frame or self._frame,
            ground_truth or self._ground_truth,
        )
        if self._pixel is not None:
            self._trace(*self._pixel)

    def set_scene(self, scene: SceneRenderer, display: DisplayParams, translation: Translation) -> None:
        """Set the 3D views for the points, and the display parameters with their depth stretch."""
        self._scene, self._display, self._translation = scene, display, translation

    def probe_pixel(self, column: str, row: int, col: int) -> None:
        """Probe the pixel under the mouse; (-1, -1) for none."""
        preview = self._window.columns[column].view.preview
        text = preview.describe_pixel(row, col) if preview is not None and row >= 0 else ""
        true = self._describe_truth(column, row, col) if text else ""
        ending = f" · truth {true}" if true else ""
        self._window.readout.setText(f"{self._get_title(column)} {text}{ending}" if text else "")
        if not self._frozen and row >= 0:
            self._trace(column, row, col)

    def toggle_pin(self, column: str, row: int, col: int) -> None:
        """Pin a pixel, or release it if it is the pinned one."""
        self._frozen = not (self._frozen and self._pixel == (column, row, col))
        self._trace(column, row, col)
        self.pin_changed.emit(self._frozen)

    def move_to_pixel(self, column: str, row: int, col: int) -> None:
        """Move the probe, and the pin if one is set, to another pixel."""
        frozen, self._frozen = self._frozen, False
        self.probe_pixel(column, row, col)
        self._frozen = frozen
        if frozen:
            self._trace(column, row, col)
        self.pixel_moved.emit(column, row, col)

    def set_frozen(self, frozen: bool) -> None:
        """Pin or release the probed pixel."""
        self._frozen = frozen
        if self._pixel is not None:
            self._trace(*self._pixel)

    def draw_pending(self) -> None:
        """Show the 3D points now instead of after the delay."""
        self._points_timer.stop()
        self._show_points()

    def clear_trace(self) -> None:
        """Clear the probe."""
        self._frozen, self._pixel, self._points = False, None, ()
        for column in self._window.columns.values():
            column.view.show_crosshair(None)
        self._window.trace.show_steps(())
        self._points_timer.start()
        self.pin_changed.emit(False)

    def _trace(self, column: str, row: int, col: int) -> None:
        preview = self._window.columns[column].view.preview
        if preview is not None and not (row < preview.pixels.shape[0] and col < preview.pixels.shape[1]):
            self.clear_trace()  # pinned in a larger preview of another sensor
            return
        self._pixel = (column, row, col)
        points = self._trace_pixel(column, row, col)
        crosses: dict[str, tuple[int, int] | None] = dict.fromkeys(self._window.columns)
        for point in points:
            crosses[point.stage] = (point.row, point.col) if point.row >= 0 else self._project_point(point)
        crosses[column] = (row, col)
        for name, shown in self._window.columns.items():
            shown.view.show_crosshair(crosses[name], self._format_value(name, crosses[name]))
        steps = [(self._get_title(m.stage), m.text) for m in points]
        ending = "" if points else _NO_SOURCE
        if not self._results or (column != pixel_trace.SOURCE and column not in self._results):
            ending = _NOT_COMPUTED
        if not points:
            steps = [(self._get_title(column), f"({col}, {row})")]
        true = self._describe_last_truth(points, (column, row, col))
        if true:
            steps.append(("truth", true))
        self._window.trace.show_steps(steps, pinned=self._frozen, ending=ending, is_waiting=ending == _NOT_COMPUTED)
        self._points = points
        if not self._points_timer.isActive():
            self._points_timer.start()

    def _format_value(self, column: str, pixel: tuple[int, int] | None) -> str:
        """Return the value of a column's preview at the crosshair."""
        preview = self._window.columns[column].view.preview
        return preview.format_value(*pixel) if preview is not None and pixel is not None else ""

    def _describe_last_truth(self, points: tuple[ProbePoint, ...], at: tuple[str, int, int]) -> str:
        """Return the truth at the last traced point, or at the probed pixel without one."""
        ends = [(point.stage, point.row, point.col) for point in points if point.row >= 0] or [at]
        return next((true for end in reversed(ends) if (true := self._describe_truth(*end))), "")

    def _describe_truth(self, column: str, row: int, col: int) -> str:
        opened = self._translation
        return (
            "" if opened is None else pixel_trace.describe_truth(column, row, col, self._ground_truth, opened.catalogue)
        )

    def _trace_pixel(self, column: str, row: int, col: int) -> tuple[ProbePoint, ...]:
        preview = self._window.columns[column].view.preview
        if self._translation is None or self._frame is None or preview is None:
            return ()
        rows, cols = preview.pixels.shape[:2]
        if not (0 <= row < rows and 0 <= col < cols):
            return ()
        index = row * cols + col if preview.element_index is None else int(preview.element_index[row, col])
        catalogue, wide = self._translation.catalogue, self._frame.image.shape[1]
        pixel = pixel_trace.trace_to_source(self._results, column, index, catalogue)
        return pixel_trace.trace_forward(self._results, *divmod(pixel, wide), wide, catalogue) if pixel >= 0 else ()

    def _project_point(self, point: ProbePoint) -> tuple[int, int] | None:
        """Return (row, col) of a 3D point in its column's preview; None outside."""
        preview = self._window.columns[point.stage].view.preview
        if point.point_mm is None or preview is None or preview.camera is None:
            return None
        x_px, y_px, visible = preview.camera.project(np.asarray([point.point_mm]))
        return (round(float(y_px[0])), round(float(x_px[0]))) if visible[0] else None

    def _get_title(self, column: str) -> str:
        if column == pixel_trace.SOURCE or self._translation is None:
            return pixel_trace.SOURCE
        return self._translation.catalogue.stage(column).title.lower()

    def _show_points(self) -> None:
        if self._scene is None or self._translation is None:
            return
        positions = compute_trace_points(self._points, self._translation, self._display)
        for column, name in enumerate(self._window.columns):
            self._scene.mark_point(column, positions.get(name))
