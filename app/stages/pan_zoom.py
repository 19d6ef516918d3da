"""The images of all columns: pan and zoom, fitted and linked in millimetres, and colour limits
dragged on them.
"""

from collections.abc import Mapping
from functools import partial

from PyQt6.QtCore import QPointF

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import DISPLAY_KEY
from pipeline.core.params import list_settings, replace_value
from pipeline.translation.pixel_trace import SOURCE
from pipeline.views.display_params import DisplayParams
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
        self._images = {name: column.view for name, column in self._columns.items()}
        self._fit, self._link = (self._actions[name] for name in ("fit_contact", "link_previews"))
        for name, view in self._images.items():
            view.view_changed.connect(partial(self._follow_view, name))
        self._fit.toggled.connect(self._fit_all)
        self._link.toggled.connect(partial(self._follow_view, "depth"))
        self._window.connect_command("reset_view", self._reset)

    def _reset(self) -> None:
        self._fit.setChecked(False)
        self._fit_all(False)

    def show_frame(self) -> None:
        """Fit its contact, if that is asked for."""
        if self._fit.isChecked():
            self._fit_all(True)

    def _fit_all(self, contact: bool) -> None:
        for name, view in self._images.items():
            if not contact:
                view.canvas.fit_view()
            elif (box := self._find_box(name, view)) is not None:
                view.fit_to_box(box)
        if contact:
            self._follow_view("depth")

    def _find_box(self, name: str, view: PreviewView) -> tuple[float, float, float, float] | None:
        """Return the contact box (left, top, right, bottom) in preview pixels; None if unknown."""
        box = view.find_contact_box_px()
        other = self._images.get(_OUTLINE_SOURCES.get(name, ""), view)
        if box is not None or other.preview is None or view.preview is None:
            return box
        box = other.find_contact_box_px()
        zoom = view.preview.pixels.shape[1] / other.preview.pixels.shape[1]
        return None if box is None else (box[0] * zoom, box[1] * zoom, box[2] * zoom, box[3] * zoom)

    def _follow_view(self, name: str, *_: object) -> None:
        """Set the views of the other images to the place and scale of one, if images are linked."""
        find_plane = self._views.find_section_plane
        moved = self._images[name]
        plane = find_plane(name, self._session)
        if not self._link.isChecked() or plane is None or moved.preview is None:
            return
        at = moved.canvas.centre
        place_mm = plane.backproject_to_mm(at.x() - 0.5, at.y() - 0.5)
        px_of_mm = moved.canvas.scale / moved.preview.pixel_mm
        for other, view in self._images.items():
            its_plane = find_plane(other, self._session)
            if other != name and its_plane is not None and view.preview is not None:
                centre = QPointF(*(its_plane.project_to_px([place_mm])[0] + 0.5))
                view.canvas.set_view(centre, px_of_mm * view.preview.pixel_mm)


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
            DISPLAY_KEY, _replace_limit(self._session.display, name, value)
        )

    def set_limits(self, limits: Mapping[str, float]) -> None:
        """Set limits fitted to the shown values, as one undo step."""
        display = self._session.display
        for name, value in limits.items():
            display = _replace_limit(display, name, value)
        params = self._session.with_display(display).params
        self._change("fit colour limits", params=params)


def _replace_limit(display: DisplayParams, name: str, value: float) -> DisplayParams:
    _, setting = list_settings(display)[name]
    # a fitted limit is 0, which a bar cannot end at
    low = setting.low or (setting.step if name.endswith("_limit_mm") else 0.0)
    return replace_value(display, name, min(max(round(value, _DIGITS), low), setting.high))
