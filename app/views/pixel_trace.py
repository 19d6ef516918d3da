"""The probe: one pixel traced through all stages, as crosshairs, 3D points and text.

Up to five pixels are pinned.
"""

from collections.abc import Mapping

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from app.views.scene_geometry import compute_trace_points
from app.window.main_window import MainWindow
from pipeline.core.graph import StageResult
from pipeline.core.values.frames import TactileFrame
from pipeline.stages.stage import GroundTruth
from pipeline.translation import pixel_trace
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.view import ProbePoint
from widgets.style.styling import make_single_shot_timer
from widgets.views.scene_renderer import SceneRenderer

_NO_SOURCE = "no source pixel maps here"
_NOT_COMPUTED = "not computed yet"
_POINTS_DELAY_MS = 40  # shortest interval between updates of the 3D points
MAX_PINS = 5
_FULL = f"{MAX_PINS} pixels are pinned; a click on a mark releases it"
_MARK_PX = 5.0  # a click closer to a mark, on screen, is meant for it

Pixel = tuple[str, int, int]  # column, row, col
Places = dict[str, tuple[int, int] | None]  # column -> row and col of a traced pixel there


class PixelProbe(QObject):
    """Traces the pixel under the mouse, or the pinned one that was chosen last, through the
    computed stages.
    """

    pin_changed = pyqtSignal(bool)  # whether the crosshair stays at a pinned pixel
    pins_changed = pyqtSignal()
    results_changed = pyqtSignal()  # what pixels are traced through
    pixel_moved = pyqtSignal(str, int, int)  # by keys: column, row, col

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._results: Mapping[str, StageResult] = {}
        self._frame: TactileFrame | None = None
        self._ground_truth = GroundTruth()
        self._pixel: Pixel | None = None
        self.pins: dict[int, Pixel] = {}  # number from 1 -> pixel
        self._active: int | None = None  # the pin that the crosshair stays at
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
        """Set the results to trace through, and the frame and truth if given.

        The probed pixel is traced again.
        """
        self._results, self._frame, self._ground_truth = (
            results,
            frame or self._frame,
            ground_truth or self._ground_truth,
        )
        self.pins = {
            number: pixel for number, pixel in self.pins.items() if self._is_inside(*pixel)
        }
        if self._pixel is not None:
            self._trace(*self._pixel)
        self.results_changed.emit()

    def set_scene(
        self, scene: SceneRenderer, display: DisplayParams, translation: Translation
    ) -> None:
        """Set the 3D views for the points, and the display parameters with their depth stretch."""
        self._scene = scene
        self._display = display
        self._translation = translation

    def probe_pixel(self, column: str, row: int, col: int) -> None:
        """Probe the pixel under the mouse; (-1, -1) for none."""
        preview = self._window.columns[column].view.preview
        text = preview.describe_pixel(row, col) if preview is not None and row >= 0 else ""
        true = self._describe_truth(column, row, col) if text else ""
        ending = f" · truth {true}" if true else ""
        self._window.show_pixel(f"{self._get_title(column)} {text}{ending}" if text else "")
        if self._active is None and row >= 0:
            self._trace(column, row, col)

    def toggle_pin(self, column: str, row: int, col: int) -> None:
        """Pin a pixel, or release the pinned one whose mark is there."""
        number = self._find_pin(column, row, col)
        free = next((n for n in range(1, MAX_PINS + 1) if n not in self.pins), None)
        if number is not None:
            self.release_pin(number)
        elif free is None:
            self._window.say(_FULL)
        else:
            self.pins[free] = (column, row, col)
            self.choose_pin(free)

    def choose_pin(self, number: int) -> None:
        """Move the crosshair to a pinned pixel."""
        self._active = number
        self._trace(*self.pins[number])
        self._report_pins()

    def release_pin(self, number: int) -> None:
        """Release a pinned pixel."""
        pixel = self.pins.pop(number)
        if self._active == number:
            self._active = None
            self._trace(*pixel)
        self._report_pins()

    def move_to_pixel(self, column: str, row: int, col: int) -> None:
        """Move the probe, and the pin it stays at if there is one, to another pixel."""
        number = self._active
        self._active = None
        self.probe_pixel(column, row, col)
        if number is not None:
            self.pins[number] = (column, row, col)
            self.choose_pin(number)
        self.pixel_moved.emit(column, row, col)

    def set_pinned(self, pinned: bool) -> None:
        """Pin the probed pixel, or release the pin that the crosshair stays at."""
        if pinned and self._active is None and self._pixel is not None:
            self.toggle_pin(*self._pixel)
        elif not pinned and self._active is not None:
            self.release_pin(self._active)
        self._report_pins()

    def _report_pins(self) -> None:
        self.pin_changed.emit(self._active is not None)
        self.pins_changed.emit()

    def _find_pin(self, column: str, row: int, col: int) -> int | None:
        """Return the pin whose mark in a column is at a pixel; None where there is none."""
        near_px = _MARK_PX / max(self._window.columns[column].view.canvas.scale, 1e-3)
        for number, pixel in self.pins.items():
            place = self.locate(*pixel)[1].get(column)
            if place is not None and max(abs(place[0] - row), abs(place[1] - col)) <= near_px:
                return number
        return None

    def _is_inside(self, column: str, row: int, col: int) -> bool:
        """Whether a pixel is in its column's preview; an empty column holds any."""
        preview = self._window.columns[column].view.preview
        return preview is None or (row < preview.pixels.shape[0] and col < preview.pixels.shape[1])

    def draw_pending(self) -> None:
        """Show the 3D points now instead of after the delay."""
        self._points_timer.stop()
        self._show_points()

    def clear_trace(self) -> None:
        """Clear the probe and all pins."""
        self.pins = {}
        self._active = None
        self._clear_crosshair()
        self._report_pins()

    def _clear_crosshair(self) -> None:
        self._pixel = None
        self._points = ()
        for column in self._window.columns.values():
            column.view.canvas.show_crosshair(None)
        self._window.trace.show_steps(())
        self._points_timer.start()

    def locate(self, column: str, row: int, col: int) -> tuple[tuple[ProbePoint, ...], Places]:
        """Return a pixel's points in all computed stages, and where it is in every column's
        preview.
        """
        points = self._trace_pixel(column, row, col)
        places: Places = dict.fromkeys(self._window.columns)
        for point in points:
            places[point.stage] = (
                (point.row, point.col) if point.row >= 0 else self._project_point(point)
            )
        places[column] = (row, col)
        return points, places

    def _trace(self, column: str, row: int, col: int) -> None:
        if not self._is_inside(column, row, col):  # of a larger preview of another sensor
            self._active = None
            self._clear_crosshair()
            self._report_pins()
            return
        self._pixel = (column, row, col)
        points, crosses = self.locate(column, row, col)
        for name, shown in self._window.columns.items():
            shown.view.canvas.show_crosshair(crosses[name], self._format_value(name, crosses[name]))
        steps = [(self._get_title(m.stage), m.text) for m in points]
        ending = "" if points else _NO_SOURCE
        if not self._results or (column != pixel_trace.SOURCE and column not in self._results):
            ending = _NOT_COMPUTED
        if not points:
            steps = [(self._get_title(column), f"({col}, {row})")]
        true = self._describe_last_truth(points, (column, row, col))
        if true:
            steps.append(("truth", true))
        self._window.trace.show_steps(
            steps,
            pinned=self._active is not None,
            ending=ending,
            is_waiting=ending == _NOT_COMPUTED,
        )
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
            ""
            if opened is None
            else pixel_trace.describe_truth(column, row, col, self._ground_truth, opened.catalogue)
        )

    def _trace_pixel(self, column: str, row: int, col: int) -> tuple[ProbePoint, ...]:
        preview = self._window.columns[column].view.preview
        if self._translation is None or self._frame is None or preview is None:
            return ()
        rows, cols = preview.pixels.shape[:2]
        if not (0 <= row < rows and 0 <= col < cols):
            return ()
        index = (
            row * cols + col
            if preview.element_index is None
            else int(preview.element_index[row, col])
        )
        catalogue = self._translation.catalogue
        wide = self._frame.image.shape[1]
        pixel = pixel_trace.trace_to_source(self._results, column, index, catalogue)
        return (
            pixel_trace.trace_forward(self._results, *divmod(pixel, wide), wide, catalogue)
            if pixel >= 0
            else ()
        )

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
