"""3D views by VTK: each is rendered off screen when it is visible and has changed.

Images are cached.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import ref

import numpy as np
from PyQt6.QtCore import QObject, QPointF, QRectF, QSize, Qt
from PyQt6.QtGui import QImage

from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.core.memo import Memo
from pipeline.views.drawing import choose_bar_length_mm
from pipeline.views.layers import Layer, ViewBounds, thin_grid
from pipeline.views.view import to_xyz
from widgets.style.styling import make_single_shot_timer
from widgets.style.theme import get_theme_colours, to_qcolor
from widgets.views.preview_renderer import make_qimage
from widgets.views.view_3d import View3D

if TYPE_CHECKING:
    from widgets.views.offscreen_renderer import OffscreenRenderer

Point3 = tuple[float, float, float]
CameraState = tuple[float, ...]  # position, focal point, up vector (x, y, z each), and view angle
_TOGETHER_MS = 10  # changes within this time are rendered once
_KEPT_BYTES = 24 * 1024 * 1024  # 18 frames of 6 views of 240 x 240 px
# search radius; thickness of a surface as a share of its distance
_NEAR_PX = 6.0
_ONE_SURFACE = 0.02
_LONGEST_BAR = 0.25  # of the width of the view
_ONE_TURN = 120  # Qt's wheel units of one notch
_BUTTONS = {
    Qt.MouseButton.LeftButton: "LeftButton",  # rotate
    Qt.MouseButton.MiddleButton: "MiddleButton",  # translate
    Qt.MouseButton.RightButton: "RightButton",  # zoom
}
_ENDS = {"press": "PressEvent", "release": "ReleaseEvent"}

# it shows these very layers, which live in other caches
CachedImage = tuple[QImage, tuple["ref[Layer]", ...]]


class SceneRenderer(QObject):
    """All 3D views, controlled by mouse.

    One view is rendered per turn of the event loop, so that the window responds.

    Until `open` has loaded OpenGL it only keeps what the views will show. An OpenGL widget would
    make Qt compose every repaint in OpenGL, which is slow without a graphics card; reading an image
    back takes less than a millisecond.
    """

    def __init__(self, views: Sequence[View3D]) -> None:
        super().__init__()
        self.views = tuple(views)
        self._opened: OffscreenRenderer | None = None
        self._mouse: Any = None  # VTK's interactor
        self._layers: dict[int, tuple[Layer, ...]] = {}
        self._marks: dict[int, Point3] = {}
        self._labels: dict[int, Mapping[str, Point3]] = {}
        # asked for before it is open
        self._bounds = dict[int, ViewBounds]()
        self._cameras = dict[int, CameraState]()
        self._is_linked = False
        self._passing: set[int] = set()  # views whose images are not shown again
        self._held: int | None = None  # view that the mouse turns
        self._scaled: set[int] = set()  # views with a scale bar
        self._due: list[int] = []
        self._kept: Memo[object, CachedImage] = Memo(most_bytes=_KEPT_BYTES, weigh=_size_bytes)
        self._finished = False
        self._turned = 0
        self.n_renders = 0  # images rendered by OpenGL
        self.render_time_s = 0.0  # and their processor time
        self._soon = make_single_shot_timer(self, _TOGETHER_MS, self._draw_one)
        for column, view in enumerate(self.views):
            view.image_requested.connect(partial(self._draw_soon, column))
            view.mouse_handler = partial(self._tell, column)

    def open(self) -> None:
        """Load OpenGL and render, unless it was closed; where that fails, the views say why."""
        if self._finished:
            return
        try:
            from vtkmodules.vtkInteractionStyle import vtkInteractorStyleTrackballCamera
            from vtkmodules.vtkRenderingUI import vtkGenericRenderWindowInteractor

            from widgets.views.offscreen_renderer import OffscreenRenderer

            self._opened = OffscreenRenderer(len(self.views), _samples())
            self._mouse = vtkGenericRenderWindowInteractor()
            self._mouse.SetRenderWindow(self._opened.window)
            self._mouse.SetInteractorStyle(vtkInteractorStyleTrackballCamera())
            self._mouse.EnableRenderOff()  # rendered together with everything else
            self._mouse.Initialize()
        except Exception as error:  # noqa: BLE001 - drivers fail in their own ways; the rest of the window must work
            self._opened = None
            for view in self.views:
                view.show_notice(f"3D needs OpenGL, which is not available here ({error})")
            return
        self.fit_cameras(self._bounds, linked=self._is_linked)
        self.set_cameras(self._cameras)

    @property
    def is_open(self) -> bool:
        """Whether the views can be rendered."""
        return self._opened is not None and not self._finished

    @property
    def _stage(self) -> OffscreenRenderer:
        assert self._opened is not None
        return self._opened

    @property
    def renderers(self) -> Sequence[Any]:
        """VTK's renderer of each view."""
        return self._stage.renderers

    def show_layers(
        self, column: int, layers: Sequence[Layer], *, is_passing: bool = False
    ) -> None:
        """Show exactly these layers in a view; of a motion, the image is not kept."""
        shown = tuple(layers)
        (self._passing.add if is_passing else self._passing.discard)(column)
        old = self._layers.get(column, ())
        if [id(layer) for layer in old] != [id(layer) for layer in shown]:
            self._layers[column] = shown
            self._draw_soon(column)

    def fit_cameras(self, bounds: Mapping[int, ViewBounds], *, linked: bool) -> None:
        """Set the cameras; views of one frame share theirs when `linked`."""
        if not self.is_open:
            self._bounds = {**self._bounds, **bounds}
            self._is_linked = linked
            self._cameras = {}
            return
        self._stage.fit_cameras(bounds, linked)
        for column in range(len(self.views)):
            self._draw_soon(column)

    def clear_cache(self) -> None:
        """Drop cached images that will not be shown again."""
        self._kept.clear()

    def get_cameras(self) -> dict[int, CameraState]:
        """Return the camera of each view; {} until it is open."""
        views = range(len(self.views)) if self.is_open else ()
        return {column: self._stage.get_camera(column) for column in views}

    def set_cameras(self, cameras: Mapping[int, CameraState]) -> None:
        """Set these cameras; other views keep theirs."""
        if not self.is_open:
            self._cameras.update(cameras)
            return
        for column, camera in cameras.items():
            self._stage.set_camera(column, camera)
            self._draw_soon(column)

    def mark_point(self, column: int, place_mm: Point3 | None) -> None:
        """Show the probe's marker over a view; None hides it. Nothing is rendered for it."""
        if place_mm is None:
            self._marks.pop(column, None)
        else:
            self._marks[column] = place_mm
        self._show_dot(column)

    def label_points(self, column: int, labels: Mapping[str, Point3]) -> None:
        """Show short texts beside points of a view."""
        self._labels[column] = labels
        self._show_dot(column)

    def look_from(self, column: int, direction: Doubles, up: Doubles) -> None:
        """Look at a view's contents from a direction (3,)."""
        if self.is_open:
            self._stage.look_from(column, direction, up)
            self._draw_soon(column)

    def set_orthographic(self, column: int, *, on: bool) -> None:
        """Draw a view without or with perspective."""
        if self.is_open and on != self._stage.is_orthographic(column):
            self._stage.set_orthographic(column, on=on)
            self._draw_soon(column)

    def show_scale_bar(self, column: int) -> None:
        """Draw a scale bar over a view from now on, right in the plane that its camera looks at."""
        self._scaled.add(column)

    def project_points(self, column: int, points_mm: Doubles) -> Doubles:
        """Return the positions (n, 2) of points (n, 3) in the view's widget."""
        return self._project(column, points_mm)[0]

    def _project(self, column: int, points_mm: Doubles) -> tuple[Doubles, Doubles]:
        """Return positions (n, 2) in the view's widget, and distances (n,)."""
        wide, high = self.views[column].width(), self.views[column].height()
        shares, depth = self._stage.project_points(column, points_mm, wide / max(1, high))
        return shares * (wide, high), depth

    def find_surface_point(self, column: int, at: QPointF) -> tuple[str, Point3] | None:
        """Return the foremost point of the drawn surfaces near a position, after the name of its
        layer; None for none.
        """
        layers = [one for one in self._layers.get(column, ()) if one.triangles is not None]
        if not layers:
            return None
        points = [
            layer.points_mm
            if layer.view_from_layer is None
            else rigid.apply(layer.view_from_layer, layer.points_mm)
            for layer in layers
        ]
        joined = np.concatenate(points).astype(np.float64)
        index = self.find_nearest_point(column, at, joined)
        if index < 0:
            return None
        last = np.cumsum([len(some) for some in points])
        return layers[int(np.searchsorted(last, index, "right"))].name, to_xyz(joined[index])

    def find_nearest_point(self, column: int, at: QPointF, points_mm: Doubles) -> int:
        """Return the foremost of the points (n, 3) drawn within a few pixels of a position.

        -1 for none.
        """
        if not self.is_open:
            return -1
        places, depth = self._project(column, points_mm)
        off_px = np.hypot(*(places - (at.x(), at.y())).T)
        near = np.flatnonzero(off_px < _NEAR_PX)
        # Of points behind each other the foremost counts; of neighbours on one surface the nearest.
        front = near[depth[near] <= depth[near].min() + _ONE_SURFACE] if near.size else near
        return int(front[np.argmin(off_px[front])]) if front.size else -1

    def draw_pending(self) -> None:
        """Render pending views now."""
        while self._due:
            self._draw_one()

    @property
    def has_pending_views(self) -> bool:
        """Whether a visible view is not rendered yet."""
        return any(self.views[column].isVisible() for column in self._due)

    def close(self) -> None:
        """Release all OpenGL resources; the last images stay."""
        self._soon.stop()
        self._due.clear()
        if self.is_open:
            self._stage.close()
        self._finished = True  # a late resize would open OpenGL again

    def _draw_soon(self, column: int) -> None:
        if not self.is_open:
            return
        if column not in self._due:
            self._due.append(column)
        if not self._soon.isActive():
            self._soon.start()

    def _draw_one(self) -> None:
        """Show cached images at once; render one of the others, the rest in later turns."""
        made = False
        waiting = [column for column in self._due if self.views[column].isVisible()]
        self._due.clear()  # an invisible view requests its image when it is shown
        while waiting and not made:
            made = self._show(waiting.pop(0))
        self._due.extend(waiting)
        if waiting:
            self._soon.start(0)
            self._soon.setInterval(_TOGETHER_MS)

    def _show(self, column: int) -> bool:
        """Show a view and return whether it had to be rendered."""
        view = self.views[column]
        layers = self._layers.get(column, ())
        ink = get_theme_colours(view.palette())
        # OpenGL takes tens of milliseconds for nothing, before the first frame is computed
        if not layers:
            blank = QImage(QSize(*view.size_px), QImage.Format.Format_RGB32)
            blank.fill(to_qcolor(ink.backdrop))
            view.show_image(blank)
            self._show_dot(column)
            return False
        is_coarse = column in self._passing or (
            self._held is not None and column in self._stage.find_linked_views(self._held)
        )
        key = (
            column,
            is_coarse,
            view.size_px,
            ink.backdrop,
            tuple(id(layer) for layer in layers),
            self._stage.get_camera(column),
        )
        image, refs = self._kept.get(key) or (None, ())
        is_kept = image is not None and all(
            one() is layer for one, layer in zip(refs, layers, strict=True)
        )
        if image is None or not is_kept:
            begun_s = time.thread_time()
            drawn = tuple(map(thin_grid, layers)) if is_coarse else layers
            self._stage.show_layers(column, drawn, ink)
            image = make_qimage(self._stage.render_pixels(column, *view.size_px, ink))
            if not is_coarse:
                self._kept.put(key, (image, tuple(ref(layer) for layer in layers)))
            self.n_renders += 1
            self.render_time_s += time.thread_time() - begun_s
        view.show_image(image)
        self._show_dot(column)
        return not is_kept

    def _show_dot(self, column: int) -> None:
        if not self.is_open:
            return
        view = self.views[column]

        def find(place: Point3 | None) -> QPointF | None:
            if place is None:
                return None
            at = QPointF(*self.project_points(column, np.array([place]))[0])
            return at if QRectF(view.rect()).contains(at) else None

        labels = {text: find(place) for text, place in self._labels.get(column, {}).items()}
        scale_bar = 0.0, ""
        if column in self._scaled:
            shorter_px = max(1, min(view.width(), view.height()))
            mm_of_px = self._stage.measure_view_mm(column) / shorter_px
            length_mm = choose_bar_length_mm(_LONGEST_BAR * view.width() * mm_of_px)
            scale_bar = length_mm / mm_of_px, f"{length_mm:g} mm" if length_mm else ""
        known = {text: at for text, at in labels.items() if at is not None}
        view.show_signs(find(self._marks.get(column)), known, scale_bar)

    def _tell(self, column: int, event: Any, what: str) -> None:
        """Pass a mouse event to VTK in pixels of its image.

        Small touch pad turns are accumulated.
        """
        if not self.is_open:
            return
        name = "MouseMoveEvent" if what == "move" else ""
        if what in _ENDS:
            self._held = column if what == "press" else None
            name = _BUTTONS.get(event.button(), "") + _ENDS[what]
            if what == "release":
                self._draw_linked(column)  # whole again
        elif what == "wheel":
            self._turned += event.angleDelta().y()
            if abs(self._turned) >= _ONE_TURN:
                name = f"MouseWheel{'Forward' if self._turned > 0 else 'Backward'}Event"
                self._turned = 0
        if not name:
            return
        view = self.views[column]
        place = (event.position() * view.devicePixelRatioF()).toPoint()
        keys = Qt.KeyboardModifier
        control, shift = (
            bool(event.modifiers() & key) for key in (keys.ControlModifier, keys.ShiftModifier)
        )
        self._stage.activate_view(column, *view.size_px)
        self._mouse.SetSize(*view.size_px)
        self._mouse.SetEventInformationFlipY(place.x(), place.y(), control, shift, chr(0), 0, None)
        before = self._stage.get_camera(column)
        self._mouse.InvokeEvent(name)
        self._stage.limit_camera(column)
        if self._stage.get_camera(column) != before:
            self._draw_linked(column)

    def _draw_linked(self, column: int) -> None:
        for other in self._stage.find_linked_views(column):
            self._draw_soon(other)


def _size_bytes(cached: CachedImage) -> int:
    return cached[0].sizeInBytes()


def _samples() -> int:
    """Return the samples per pixel: smoothing doubles the time of a software renderer."""
    devices = [*Path("/dev").glob("dri/*"), *Path("/dev").glob("nvidia*")]
    return 0 if sys.platform == "linux" and not devices else 4
