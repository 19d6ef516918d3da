"""The probe in the 3D views: the pixel under the pointer is traced like one of an image."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from PyQt6.QtCore import QPointF

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.scene_geometry import get_depth_stretch
from pipeline.core.arrays import Doubles
from pipeline.translation.pixel_trace import SOURCE
from pipeline.views.layers import stretch_depth
from pipeline.views.preview import Preview, compute_rest_depth_mm
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 40  # shortest interval between probes
_MAX_POINTS = 40_000  # per surface; neighbours are then less than a screen pixel apart


@dataclass(frozen=True, slots=True, kw_only=True)
class _Surface:
    """The pixels of a preview as 3D points."""

    preview: Preview
    depth_stretch: float
    points_mm: Doubles  # (n, 3)
    pixel_row_col: Doubles  # (n, 2) row, col


class Probe3DController(Feature):
    """Connects the 3D views with the probe: the pixel under the pointer is probed, a click pins
    it.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._pointer: tuple[str, QPointF] | None = None
        self._surfaces: dict[str, _Surface] = {}
        self._timer = make_single_shot_timer(self, _DELAY_MS, self._probe)
        for name, cell in self._window.view_panels.items():
            cell.view.hovered.connect(partial(self._schedule_probe, name))
            cell.view.clicked.connect(partial(self._pin, name))

    def _schedule_probe(self, name: str, at: QPointF) -> None:
        self._pointer = (name, at)
        if not self._timer.isActive():
            self._timer.start()

    def _probe(self) -> None:
        if self._pointer is None or self._controller.is_closed:
            return
        pixel = self._find_pixel(*self._pointer)
        if pixel is not None:
            self._controller.probe.probe_pixel(self._pointer[0], *pixel)

    def _pin(self, name: str, at: QPointF) -> None:
        pixel = self._find_pixel(name, at)
        if pixel is not None:
            self._controller.probe.toggle_pin(name, *pixel)

    def _find_pixel(self, name: str, at: QPointF) -> tuple[int, int] | None:
        """Return (row, col) of the preview pixel nearest to a point of the 3D view.

        None if none is near.
        """
        surface = self._get_surface(name)
        if surface is None or not len(surface.points_mm):
            return None
        column = list(self._window.columns).index(name)
        index = self._controller.views.scene.find_nearest_point(column, at, surface.points_mm)
        return (
            None
            if index < 0
            else (int(surface.pixel_row_col[index, 0]), int(surface.pixel_row_col[index, 1]))
        )

    def _get_surface(self, name: str) -> _Surface | None:
        opened = self._controller.views.translation
        preview = self._window.columns[name].view.preview
        if opened is None or preview is None:
            return None
        sensor = opened.get_sensor(name)
        stretch = get_depth_stretch(name, opened, self._controller.session.display)
        cached = self._surfaces.get(name)
        if cached is not None and cached.preview is preview and cached.depth_stretch == stretch:
            return cached
        positions = preview.compute_positions_mm()
        if positions is None and name == SOURCE:  # a gel's image lies on its rest surface
            camera = sensor.camera.scale(preview.pixels.shape[1] / sensor.camera.cols)
            positions = camera.back_project(compute_rest_depth_mm(sensor, camera)).astype(
                np.float32
            )
        if positions is None:
            return None
        step = max(1, int(np.ceil(np.sqrt(positions.shape[0] * positions.shape[1] / _MAX_POINTS))))
        rows, cols = np.mgrid[0 : positions.shape[0] : step, 0 : positions.shape[1] : step]
        points = positions[::step, ::step].reshape(-1, 3)
        finite = np.isfinite(points).all(axis=1)
        surface = _Surface(
            preview=preview,
            depth_stretch=stretch,
            points_mm=stretch_depth(points[finite], sensor, stretch),
            pixel_row_col=np.stack([rows.ravel()[finite], cols.ravel()[finite]], axis=-1).astype(
                np.float64
            ),
        )
        self._surfaces[name] = surface
        return surface
