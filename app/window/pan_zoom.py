"""Where the pictures look: fitted to the contact or the sensor, and moved together in millimetres."""

from __future__ import annotations

from functools import partial

from PyQt6.QtCore import QObject, QPointF

from app.window.session_controller import SessionController
from pipeline.geometry import rigid
from pipeline.previews.preview import Preview
from pipeline.sensors.spec import SensorSpec
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation
from widgets.preview_view import PreviewView

_SHOWS = {SOURCE: "depth", "cloud": "target_depth"}  # whose contact is fitted in pictures that outline none


class PanZoomController(QObject):
    """Pans and zooms the pictures of all columns."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._window = controller, controller.window
        self._views = {name: column.view for name, column in self._window.columns.items()}
        self._fit, self._link = (self._window.actions_by_name[name] for name in ("fit_contact", "link_previews"))
        for name, view in self._views.items():
            view.view_changed.connect(partial(self._moved, name))
        self._fit.toggled.connect(self._fit_all)
        self._link.toggled.connect(partial(self._moved, "depth"))
        self._window.connect_command("reset_view", self._reset)
        controller.frame_shown.connect(self._frame_shown)

    def _reset(self) -> None:
        self._fit.setChecked(False)
        self._fit_all(False)

    def _frame_shown(self, _: int) -> None:
        if self._fit.isChecked():
            self._fit_all(True)

    def _fit_all(self, contact: bool) -> None:
        for name, view in self._views.items():
            box = self._box(name, view) if contact else None
            if box is not None:
                view.fit_to_box(box)
            elif not contact:
                view.reset_view()
        if contact and self._link.isChecked():
            self._moved("depth")

    def _box(self, name: str, view: PreviewView) -> tuple[float, float, float, float] | None:
        """The contact in a picture's pixels; of one without an outline that of its fellow."""
        fellow = self._views.get(_SHOWS.get(name, ""), view)
        box = view.find_contact_box_px() or fellow.find_contact_box_px()
        if box is None or view.preview is None or fellow.preview is None:
            return None
        times = 1.0 if view.find_contact_box_px() else view.preview.pixels.shape[1] / fellow.preview.pixels.shape[1]
        left, top, right, below = box
        return left * times, top * times, right * times, below * times

    def _moved(self, name: str, *_: object) -> None:
        """What one picture looks at, the others look at, as large."""
        opened, view = self._controller.views.translation, self._views.get(name)
        if not self._link.isChecked() or opened is None or view is None or view.preview is None:
            return
        own = view.preview
        x_mm, y_mm = _in_mm(own, _sensor(opened, name), view.canvas.centre)
        px_of_mm = view.canvas.scale / own.pixel_mm
        at_source = _place(opened, name) == "source"
        for other, there in self._views.items():
            picture = there.preview
            if other == name or picture is None:
                continue
            x, y = x_mm, y_mm
            if (_place(opened, other) == "source") != at_source:
                x, y = _across(opened, (x_mm, y_mm), to_target=at_source)
            centre = _in_px(picture, _sensor(opened, other), x, y)
            there.canvas.set_view(centre, px_of_mm * picture.pixel_mm)


def _place(opened: Translation, name: str) -> str:
    return "source" if name == SOURCE else opened.catalogue.stage(name).sensor_role


def _sensor(opened: Translation, name: str) -> SensorSpec:
    return opened.source if _place(opened, name) == "source" else opened.target


def _middle_px(picture: Preview, sensor: SensorSpec) -> tuple[float, float]:
    """Where the optical axis meets a picture of the sensor."""
    times = picture.pixels.shape[1] / sensor.camera.cols
    return (sensor.camera.cx_px + 0.5) * times, (sensor.camera.cy_px + 0.5) * times


def _in_mm(picture: Preview, sensor: SensorSpec, at: QPointF) -> tuple[float, float]:
    """How far from the optical axis a point of a picture is, on the sensor's surface."""
    x, y = _middle_px(picture, sensor)
    return (at.x() - x) * picture.pixel_mm, (at.y() - y) * picture.pixel_mm


def _in_px(picture: Preview, sensor: SensorSpec, x_mm: float, y_mm: float) -> QPointF:
    x, y = _middle_px(picture, sensor)
    return QPointF(x + x_mm / picture.pixel_mm, y + y_mm / picture.pixel_mm)


def _across(opened: Translation, at_mm: tuple[float, float], *, to_target: bool) -> tuple[float, float]:
    """The same place of the touch on the other sensor."""
    onward = opened.alignment.target_from_source
    sensor = opened.source if to_target else opened.target
    z_mm = float(sensor.rest_depth_mm[sensor.camera.rows // 2, sensor.camera.cols // 2])
    x, y, _ = rigid.apply(onward if to_target else rigid.invert(onward), (*at_mm, z_mm))
    return float(x), float(y)
