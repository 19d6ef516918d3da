"""The probe in the 3D views: the pixel under the pointer is traced like one of an image."""

from functools import partial

import numpy as np
from PyQt6.QtCore import QPointF

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.scene_geometry import get_depth_stretch
from pipeline.translation.cross_section import find_image_camera
from pipeline.views.layers import Layer, stretch_depth
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 40  # shortest interval between probes


class Probe3DController(Feature):
    """Connects the 3D views with the probe: the pixel under the pointer is probed, a click pins
    it.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._pointer: tuple[str, QPointF] | None = None
        self._timer = make_single_shot_timer(self, _DELAY_MS, self._probe)
        for name, cell in self._window.view_panels.items():
            cell.view.hovered.connect(partial(self._schedule_probe, name))
            cell.view.clicked.connect(partial(self._pin, name))

    def _schedule_probe(self, name: str, at: QPointF) -> None:
        self._pointer = (name, at)
        if not self._timer.isActive():
            self._timer.start()

    def _probe(self) -> None:
        if self._pointer is not None and (pixel := self._find_pixel(*self._pointer)) is not None:
            self._controller.probe.probe_pixel(self._pointer[0], *pixel)

    def _pin(self, name: str, at: QPointF) -> None:
        pixel = self._find_pixel(name, at)
        if pixel is not None:
            self._controller.probe.toggle_pin(name, *pixel)

    def _find_pixel(self, name: str, at: QPointF) -> tuple[int, int] | None:
        """Return (row, col) in the preview of what the 3D view draws at a position.

        None if nothing is near.
        """
        opened, views = self._translation, self._views
        preview = self._columns[name].view.preview
        part = views.get_shown_stage(name)
        if opened is None or preview is None or part is None:
            return None
        measured = [layer.points_mm for layer in part.layers if _is_measured(layer)]
        points = np.concatenate([np.empty((0, 3)), *measured], dtype=np.float64)
        index = views.scene.find_nearest_point(views.places[name], at, points)
        if index < 0:
            return None
        sensor = opened.get_sensor(name)
        stretch = get_depth_stretch(name, opened, self._session.display)
        true = stretch_depth(points[index : index + 1], sensor, 1.0 / stretch)
        x_px, y_px, _ = find_image_camera(preview, sensor).project(true)
        return round(float(y_px[0])), round(float(x_px[0]))


def _is_measured(layer: Layer) -> bool:
    """Whether a layer draws what the stage found: no lines, no object, no surface at rest."""
    is_found = layer.segments is None and layer.view_from_layer is None
    return is_found and layer.name != "membrane"
