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
from pipeline.views.preview import Preview
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
        self._columns = window.columns
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
        self._results = results
        self._frame = frame or self._frame
        self._ground_truth = ground_truth or self._ground_truth
        self.pins = {n: pixel for n, pixel in self.pins.items() if self._is_inside(*pixel)}
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
        preview = self._get_preview(column)
        text = "" if preview is None else preview.describe_pixel(row, col)
        if text:
            text = f"{self._get_title(column)} {text}"
            true = self._describe_truth(column, row, col)
            text += f" · truth {true}" if true else ""
        self._window.show_pixel(text)
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
        self.probe_pixel(column, row, col)
        if self._active is not None:
            self.pins[self._active] = (column, row, col)
            self.choose_pin(self._active)
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
        near_px = _MARK_PX / max(self._columns[column].view.canvas.scale, 1e-3)
        for number, pixel in self.pins.items():
            place = self.locate(*pixel)[1].get(column)
            if place is not None and max(abs(place[0] - row), abs(place[1] - col)) <= near_px:
                return number
        return None

    def _is_inside(self, column: str, row: int, col: int) -> bool:
        """Whether a pixel is in its column's preview; an empty column holds any."""
        preview = self._get_preview(column)
        if preview is None:
            return True
        rows, cols, _ = preview.pixels.shape
        return row < rows and col < cols

    def _get_preview(self, column: str) -> Preview | None:
        return self._columns[column].view.preview

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
        for column in self._columns.values():
            column.view.canvas.show_crosshair(None)
        self._window.trace.show_steps(())
        self._points_timer.start()

    def locate(self, column: str, row: int, col: int) -> tuple[tuple[ProbePoint, ...], Places]:
        """Return a pixel's points in all computed stages, and where it is in every column's
        preview.
        """
        points = self._trace_pixel(column, row, col)
        places: Places = dict.fromkeys(self._columns)
        places |= {point.stage: self._place_point(point) for point in points}
        return points, {**places, column: (row, col)}

    def _trace(self, column: str, row: int, col: int) -> None:
        if not self._is_inside(column, row, col):  # of a larger preview of another sensor
            self._active = None
            self._clear_crosshair()
            self._report_pins()
            return
        self._pixel = (column, row, col)
        points, crosses = self.locate(column, row, col)
        for name, place in crosses.items():
            preview = self._get_preview(name)
            text = preview.format_value(*place) if preview and place else ""
            self._columns[name].view.canvas.show_crosshair(place, text)
        steps = [(self._get_title(m.stage), m.text) for m in points]
        is_waiting = not self._results or column not in (pixel_trace.SOURCE, *self._results)
        ending = _NOT_COMPUTED if is_waiting else "" if points else _NO_SOURCE
        if not points:
            steps = [(self._get_title(column), f"({col}, {row})")]
        ends = [(p.stage, p.row, p.col) for p in points if p.row >= 0] or [self._pixel]
        trues = [true for end in ends if (true := self._describe_truth(*end))]
        steps += [("truth", true) for true in trues[-1:]]
        self._window.trace.show_steps(
            steps, pinned=self._active is not None, ending=ending, is_waiting=is_waiting
        )
        self._points = points
        if not self._points_timer.isActive():
            self._points_timer.start()

    def _describe_truth(self, column: str, row: int, col: int) -> str:
        opened, truth = self._translation, self._ground_truth
        if opened is None:
            return ""
        return pixel_trace.describe_truth(column, row, col, truth, opened.catalogue)

    def _trace_pixel(self, column: str, row: int, col: int) -> tuple[ProbePoint, ...]:
        preview = self._get_preview(column)
        if self._translation is None or self._frame is None or preview is None:
            return ()
        rows, cols, _ = preview.pixels.shape
        if not (0 <= row < rows and 0 <= col < cols):
            return ()
        elements = preview.element_index
        index = row * cols + col if elements is None else int(elements[row, col])
        catalogue = self._translation.catalogue
        wide = self._frame.image.shape[1]
        pixel = pixel_trace.trace_to_source(self._results, column, index, catalogue)
        if pixel < 0:
            return ()
        return pixel_trace.trace_forward(self._results, *divmod(pixel, wide), wide, catalogue)

    def _place_point(self, point: ProbePoint) -> tuple[int, int] | None:
        """Return (row, col) of a traced point in its column's preview; None outside."""
        if point.row >= 0:
            return point.row, point.col
        preview = self._get_preview(point.stage)
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
        for column, name in enumerate(self._columns):
            self._scene.mark_point(column, positions.get(name))
