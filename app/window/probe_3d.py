"""From a place in a 3D view to the pixel that is seen there, which is then traced like one of a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from PyQt6.QtCore import QObject, QPointF

from app.window.session_controller import SessionController
from pipeline.base.arrays import Doubles
from pipeline.previews.layers import stretch_depth
from pipeline.previews.preview import Preview, compute_rest_depth_mm
from pipeline.translation.pixel_trace import SOURCE
from widgets.styling import make_single_shot_timer

_AFTER_MS = 40  # the mouse is followed at most this often
_MOST_POINTS = 40_000  # of a surface that are looked at: neighbours are less than a pixel of a view apart


@dataclass(frozen=True, slots=True, kw_only=True)
class _Surface:
    """A picture's pixels where they are drawn in 3D."""

    preview: Preview
    depth_stretch: float  # that its indentation is stretched
    points_mm: Doubles  # (n, 3)
    pixel_row_col: Doubles  # (n, 2) row, col


class Probe3DController(QObject):
    """Listens to the 3D views of the columns: what the pointer is over is traced, a click pins it."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._at: tuple[str, QPointF] | None = None
        self._surfaces: dict[str, _Surface] = {}
        self._soon = make_single_shot_timer(self, _AFTER_MS, self._hover)
        for name, cell in self._window.view_panels.items():
            cell.view.hovered.connect(partial(self._hovered, name))
            cell.view.clicked.connect(partial(self._clicked, name))

    def _hovered(self, name: str, at: QPointF) -> None:
        self._at = (name, at)
        if not self._soon.isActive():
            self._soon.start()

    def _hover(self) -> None:
        if self._at is None or self._controller.is_closed:
            return
        found = self._pixel(*self._at)
        if found is not None:
            self._controller.probe.probe_pixel(self._at[0], *found)

    def _clicked(self, name: str, at: QPointF) -> None:
        found = self._pixel(name, at)
        if found is not None:
            self._controller.probe.toggle_pin(name, *found)

    def _pixel(self, name: str, at: QPointF) -> tuple[int, int] | None:
        """(row, col) of the picture that is seen at a place of its 3D view; None where none is near."""
        surface = self._surface(name)
        if surface is None or not len(surface.points_mm):
            return None
        column = list(self._window.columns).index(name)
        index = self._controller.views.scene.find_nearest_point(column, at, surface.points_mm)
        return None if index < 0 else (int(surface.pixel_row_col[index, 0]), int(surface.pixel_row_col[index, 1]))

    def _surface(self, name: str) -> _Surface | None:
        opened, picture = self._controller.views.translation, self._window.columns[name].view.preview
        if opened is None or picture is None:
            return None
        slot = None if name == SOURCE else opened.catalogue.stage(name)
        sensor = opened.source if slot is None or slot.sensor_role == "source" else opened.target
        display = self._controller.session.display
        times = display.get_depth_stretch(sensor) if slot is not None and slot.exaggerates_indentation else 1.0
        kept = self._surfaces.get(name)
        if kept is not None and kept.preview is picture and kept.depth_stretch == times:
            return kept
        positions = picture.compute_positions_mm()
        if positions is None and slot is None:  # a gel's reading is drawn on its untouched surface
            camera = sensor.camera.scale(picture.pixels.shape[1] / sensor.camera.cols)
            positions = camera.back_project(compute_rest_depth_mm(sensor, camera)).astype(np.float32)
        if positions is None:
            return None
        step = max(1, int(np.ceil(np.sqrt(positions.shape[0] * positions.shape[1] / _MOST_POINTS))))
        rows, cols = np.mgrid[0 : positions.shape[0] : step, 0 : positions.shape[1] : step]
        points = positions[::step, ::step].reshape(-1, 3)
        known = np.isfinite(points).all(axis=1)
        found = _Surface(
            preview=picture, depth_stretch=times, points_mm=stretch_depth(points[known], sensor, times),
            pixel_row_col=np.stack([rows.ravel()[known], cols.ravel()[known]], axis=-1).astype(np.float64),
        )  # fmt: skip
        self._surfaces[name] = found
        return found
