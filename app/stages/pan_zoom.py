"""The images of all columns: pan and zoom, fitted and linked in millimetres, and colour limits
dragged on them.
"""

from collections.abc import Mapping
from functools import partial

from PyQt6.QtCore import QPointF

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import DISPLAY_KEY
from pipeline.core.geometry import rigid
from pipeline.core.params import list_settings, replace_value
from pipeline.sensors.spec import SensorSpec
from pipeline.translation.pixel_trace import SOURCE
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview
from widgets.views.preview_view import PreviewView

_OUTLINE_SOURCES = {
    SOURCE: "depth",
    "cloud": "target_depth",
}  # stage whose contact is used for images without an outline
_DIGITS = 2  # decimals of a limit in mm


class PanZoomController(Feature):
    """Pans and zooms the images of all columns."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._views = {name: column.view for name, column in self._window.columns.items()}
        self._fit, self._link = (
            self._window.actions_by_name[name] for name in ("fit_contact", "link_previews")
        )
        for name, view in self._views.items():
            view.view_changed.connect(partial(self._follow_view, name))
        self._fit.toggled.connect(self._fit_all)
        self._link.toggled.connect(partial(self._follow_view, "depth"))
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
            box = self._find_box(name, view) if contact else None
            if box is not None:
                view.fit_to_box(box)
            elif not contact:
                view.canvas.fit_view()
        if contact and self._link.isChecked():
            self._follow_view("depth")

    def _find_box(self, name: str, view: PreviewView) -> tuple[float, float, float, float] | None:
        """Return the contact box (left, top, right, bottom) in preview pixels; None if unknown."""
        other_view = self._views.get(_OUTLINE_SOURCES.get(name, ""), view)
        box = view.find_contact_box_px() or other_view.find_contact_box_px()
        if box is None or view.preview is None or other_view.preview is None:
            return None
        zoom = (
            1.0
            if view.find_contact_box_px()
            else view.preview.pixels.shape[1] / other_view.preview.pixels.shape[1]
        )
        left, top, right, below = box
        return left * zoom, top * zoom, right * zoom, below * zoom

    def _follow_view(self, name: str, *_: object) -> None:
        """Set the views of the other images to the place and scale of one, if images are linked."""
        opened = self._controller.views.translation
        view = self._views.get(name)
        if not self._link.isChecked() or opened is None or view is None or view.preview is None:
            return
        moved = view.preview
        x_mm, y_mm = _to_mm(moved, opened.get_sensor(name), view.canvas.centre)
        px_of_mm = view.canvas.scale / moved.pixel_mm
        at_source = opened.get_role(name) == "source"
        for other, other_panel in self._views.items():
            preview = other_panel.preview
            if other == name or preview is None:
                continue
            x = x_mm
            y = y_mm
            if (opened.get_role(other) == "source") != at_source:
                x, y = _transfer_point(opened, (x_mm, y_mm), to_target=at_source)
            centre = _to_px(preview, opened.get_sensor(other), x, y)
            other_panel.canvas.set_view(centre, px_of_mm * preview.pixel_mm)


def _find_axis_px(preview: Preview, sensor: SensorSpec) -> tuple[float, float]:
    """Return x, y in preview pixels of the optical axis."""
    zoom = preview.pixels.shape[1] / sensor.camera.cols
    return (sensor.camera.cx_px + 0.5) * zoom, (sensor.camera.cy_px + 0.5) * zoom


def _to_mm(preview: Preview, sensor: SensorSpec, at: QPointF) -> tuple[float, float]:
    """Return x, y in mm from the optical axis on the sensor's surface."""
    x, y = _find_axis_px(preview, sensor)
    return (at.x() - x) * preview.pixel_mm, (at.y() - y) * preview.pixel_mm


def _to_px(preview: Preview, sensor: SensorSpec, x_mm: float, y_mm: float) -> QPointF:
    x, y = _find_axis_px(preview, sensor)
    return QPointF(x + x_mm / preview.pixel_mm, y + y_mm / preview.pixel_mm)


def _transfer_point(
    opened: Translation, at_mm: tuple[float, float], *, to_target: bool
) -> tuple[float, float]:
    """Transfer a point x, y in mm to the other sensor by the alignment."""
    target_from_source = opened.alignment.target_from_source
    sensor = opened.source if to_target else opened.target
    z_mm = float(sensor.rest_depth_mm[sensor.camera.rows // 2, sensor.camera.cols // 2])
    x, y, _ = rigid.apply(
        target_from_source if to_target else rigid.invert(target_from_source), (*at_mm, z_mm)
    )
    return float(x), float(y)


class ColourLimitController(Feature):
    """Connects the colour bars with the session."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        window = controller.window
        bars = [column.view.colour_bar for column in window.columns.values()]
        for source in (*bars, *(tab.grid for tab in window.comparison.tile_tabs)):
            source.limit_dragged.connect(self.set_limit)
            source.limits_fitted.connect(self.set_limits)

    def set_limit(self, name: str, value: float) -> None:
        """Set a limit within its range; a drag is one undo step."""
        self._controller.choose_params(
            DISPLAY_KEY, _replace_limit(self._controller.session.display, name, value)
        )

    def set_limits(self, limits: Mapping[str, float]) -> None:
        """Set limits fitted to the shown values, as one undo step."""
        display = self._controller.session.display
        for name, value in limits.items():
            display = _replace_limit(display, name, value)
        params = self._controller.session.with_display(display).params
        self._controller.change("fit colour limits", params=params)


def _replace_limit(display: DisplayParams, name: str, value: float) -> DisplayParams:
    _, setting = list_settings(display)[name]
    # a fitted limit is 0, which a bar cannot end at
    low = setting.low or (setting.step if name.endswith("_limit_mm") else 0.0)
    return replace_value(display, name, min(max(round(value, _DIGITS), low), setting.high))
