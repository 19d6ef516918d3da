"""Off-screen renderer of the 3D views: layers, cameras, lights and axes, one view at a time."""

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import pyvista as pv
import vtkmodules.vtkRenderingOpenGL2  # pyright: ignore[reportUnusedImport]  # noqa: F401 - registers what draws
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkCamera,
    vtkLight,
    vtkPolyDataMapper,
    vtkRenderer,
    vtkRenderWindow,
)

from pipeline.core.arrays import Doubles, Image
from pipeline.views.colours import darken_diverging
from pipeline.views.layers import FIELD_OF_VIEW_DEG, VIEW_DISTANCE, Layer, ViewBounds
from widgets.style.theme import ThemeColours, get_colour_map

_LINE_PX = 1.5
_ORTHOGRAPHIC_DEG = 0.5  # so narrow an angle shows nothing of perspective
_HALF_VIEW = math.tan(0.5 * math.radians(FIELD_OF_VIEW_DEG))
_ZOOM_LIMITS = 0.02, 4.0  # distances of a camera, in those of the fitted one
# of a layer: equal ones differ at most in where they are
_ARRAYS = "points_mm", "rgb", "scale", "triangles", "segments", "normals"
_BEHIND = 4.0, 4.0  # polygon offset: slope factor and units of the depth buffer


class OffscreenRenderer:
    """Renders one view after the other into one window.

    Points are updated in place, actors are never rebuilt.
    """

    def __init__(self, columns: int, samples: int) -> None:
        self.window = vtkRenderWindow()
        self.window.SetOffScreenRendering(True)
        self.window.SetMultiSamples(samples)
        self.renderers = [_view() for _ in range(columns)]
        for renderer in self.renderers:
            self.window.AddRenderer(renderer)
        self._kept: list[dict[str, tuple[Layer, Any, Any, ThemeColours]]] = [
            {} for _ in range(columns)
        ]
        self._sights: dict[int, ViewBounds] = {}
        self._axes = [[_arrow(renderer, axis) for axis in range(3)] for renderer in self.renderers]

    def render_pixels(self, column: int, width_px: int, height_px: int, ink: ThemeColours) -> Image:
        """Return one view rendered at this size in the theme's colours, (rows, cols, 3)."""
        self.activate_view(column, width_px, height_px)
        self.renderers[column].SetBackground(*np.divide(ink.backdrop, 255))
        for arrow, colour in zip(self._axes[column], ink.axes, strict=True):
            arrow.GetProperty().SetColor(*np.divide(colour, 255))
        self.window.Render()
        drawn = vtkUnsignedCharArray()
        self.window.GetPixelData(0, 0, width_px - 1, height_px - 1, 0, drawn, 0)
        return np.ascontiguousarray(vtk_to_numpy(drawn).reshape(height_px, width_px, 3)[::-1])

    def activate_view(self, column: int, width_px: int, height_px: int) -> None:
        """Make this view the window's only view, for rendering and for the mouse.

        The view angle applies to the shorter side, so that a sphere fits tall and wide views alike.
        """
        for other, renderer in enumerate(self.renderers):
            renderer.SetDraw(other == column)
            renderer.SetInteractive(other == column)
        if tuple(self.window.GetSize()) != (width_px, height_px):
            self.window.SetSize(width_px, height_px)
        self.renderers[column].GetActiveCamera().SetUseHorizontalViewAngle(width_px < height_px)

    def close(self) -> None:
        """Release all OpenGL resources."""
        self.window.Finalize()

    def show_layers(self, column: int, layers: Sequence[Layer], ink: ThemeColours) -> None:
        """Show exactly these layers in the theme's colours."""
        kept = self._kept[column]
        layers = [layer for layer in layers if len(layer.points_mm)]  # VTK accepts no empty arrays
        wanted = {layer.name for layer in layers}
        for name, (_, _, actor, _) in kept.items():
            actor.SetVisibility(name in wanted)
        for layer in layers:
            old = kept.get(layer.name)
            if old is None:
                mesh = pv.PolyData()
                _write(mesh, layer, None, ink)
                actor = _add_layer(self.renderers[column], mesh, layer)
            else:
                mesh = old[1]
                actor = old[2]
                if old[3] is not ink or not _has_same_arrays(old[0], layer, *_ARRAYS):
                    _write(mesh, layer, old[0], ink)
            at = layer.view_from_layer
            actor.SetUserMatrix(None if at is None else pv.vtkmatrix_from_array(at))
            kept[layer.name] = (layer, mesh, actor, ink)

    def get_camera(self, column: int) -> tuple[float, ...]:
        """Return the camera of a view; equal for equal views."""
        camera = self.renderers[column].GetActiveCamera()
        vectors = camera.GetPosition(), camera.GetFocalPoint(), camera.GetViewUp()
        return (*chain(*vectors), camera.GetViewAngle())

    def set_camera(self, column: int, numbers: tuple[float, ...]) -> None:
        """Set the camera of a view as `get_camera` returns it."""
        camera = self.renderers[column].GetActiveCamera()
        camera.SetPosition(*numbers[:3])
        camera.SetFocalPoint(*numbers[3:6])
        camera.SetViewUp(*numbers[6:9])
        camera.SetViewAngle(numbers[9])

    def look_from(self, column: int, direction: Doubles, up: Doubles) -> None:
        """Look at what the view was fitted to from a direction, at the same size."""
        camera = self.renderers[column].GetActiveCamera()
        toward = direction / np.linalg.norm(direction)
        sight = self._sights.get(column)
        centre = np.array(camera.GetFocalPoint() if sight is None else sight.centre_mm)
        camera.SetPosition(*(centre + camera.GetDistance() * toward))
        camera.SetFocalPoint(*centre)
        camera.SetViewUp(*up)

    def set_orthographic(self, column: int, *, on: bool) -> None:
        """Draw without perspective, which is from far away, or with it; the size stays."""
        camera = self.renderers[column].GetActiveCamera()
        before = _half_view(camera)
        camera.SetViewAngle(_ORTHOGRAPHIC_DEG if on else FIELD_OF_VIEW_DEG)
        camera.Dolly(_half_view(camera) / before)

    def is_orthographic(self, column: int) -> bool:
        """Whether a view is drawn without perspective."""
        return self.renderers[column].GetActiveCamera().GetViewAngle() <= _ORTHOGRAPHIC_DEG

    def limit_camera(self, column: int) -> None:
        """Keep what the view was fitted to in sight: neither lost by zoom nor by panning."""
        sight = self._sights.get(column)
        if sight is None:
            return
        camera = self.renderers[column].GetActiveCamera()
        fitted = VIEW_DISTANCE * sight.radius_mm * _HALF_VIEW / _half_view(camera)
        distance = camera.GetDistance() / fitted
        limited = float(np.clip(distance, *_ZOOM_LIMITS))
        if limited != distance:
            camera.Dolly(distance / limited)
        off = np.array(camera.GetFocalPoint()) - sight.centre_mm
        too_far = float(np.linalg.norm(off)) / sight.radius_mm
        if too_far > 1.0:
            back = off / too_far - off
            camera.SetPosition(*np.add(camera.GetPosition(), back))
            camera.SetFocalPoint(*np.add(camera.GetFocalPoint(), back))

    def measure_view_mm(self, column: int) -> float:
        """Return the length of the shorter side of a view where its camera looks at."""
        camera = self.renderers[column].GetActiveCamera()
        return 2.0 * camera.GetDistance() * _half_view(camera)

    def find_linked_views(self, column: int) -> list[int]:
        """Return the views that share this view's camera, itself first."""
        own = self.renderers[column].GetActiveCamera()
        views = range(len(self.renderers))
        return sorted(
            (i for i in views if self.renderers[i].GetActiveCamera() is own),
            key=lambda i: i != column,
        )

    def project_points(
        self, column: int, points_mm: Doubles, aspect: float
    ) -> tuple[Doubles, Doubles]:
        """Return the positions (n, 2) of points (n, 3) as shares of width and height from the
        upper left, and their distances (n,) relative to the nearest.

        What is behind the camera is far outside.
        """
        camera = self.renderers[column].GetActiveCamera()
        camera.SetUseHorizontalViewAngle(aspect < 1.0)
        matrix = pv.array_from_vtkmatrix(
            camera.GetCompositeProjectionTransformMatrix(aspect, -1.0, 1.0)
        )
        seen = points_mm @ matrix[:, :3].T + matrix[:, 3]
        w = np.where(seen[:, 3] > 0, seen[:, 3], np.inf)
        shares = np.stack([0.5 + 0.5 * seen[:, 0] / w, 0.5 - 0.5 * seen[:, 1] / w], axis=-1)
        shares[np.isinf(w)] = -9.0
        return shares, w / w.min(initial=1e12)

    def fit_cameras(self, bounds: Mapping[int, ViewBounds], linked: bool) -> None:
        """Set cameras on the sensor's side, so that indentation bulges toward the viewer."""
        shared: dict[str, Any] = {}
        self._sights.update(bounds)
        for column, sight in bounds.items():
            camera = shared.get(sight.frame) if linked else None
            if camera is None:
                camera = shared[sight.frame] = _camera(sight)
            self.renderers[column].SetActiveCamera(camera)
            # the arrows end above the caption
            corner = np.array(sight.centre_mm) + sight.radius_mm * np.array([-0.72, 0.5, 0.0])
            origin = corner if sight.origin_mm is None else sight.origin_mm
            for actor in self._axes[column]:
                actor.SetPosition(*origin)
                actor.SetScale(0.25 * sight.radius_mm)
                actor.SetVisibility(True)


def _view() -> Any:
    """Return an empty sub-view with a headlight for true colours and a light from the upper left
    for relief.
    """
    renderer: Any = vtkRenderer()
    renderer.SetAutomaticLightCreation(False)
    renderer.SetUseOIT(False)  # sorting the few faint surfaces by pixel doubles the time
    headlight = vtkLight()
    side = vtkLight()
    headlight.SetLightTypeToHeadlight()
    headlight.SetIntensity(0.55)
    side.SetLightTypeToCameraLight()
    side.SetIntensity(0.6)
    side.SetPosition(-1.0, 1.0, 0.6)
    for light in (headlight, side):
        renderer.AddLight(light)
    # Cameras may be shared and layers may come later: every view sets its clipping range when it is
    # rendered.
    renderer.AddObserver("StartEvent", _cut_to_its_own)
    return renderer


def _cut_to_its_own(renderer: Any, _: str) -> None:
    renderer.ResetCameraClippingRange()


def _half_view(camera: Any) -> float:
    """Return half of what a camera sees at a distance of 1."""
    return math.tan(0.5 * math.radians(camera.GetViewAngle()))


def _camera(sight: ViewBounds) -> Any:
    """Return a camera along the view's direction, so far that the sphere fills the width."""
    camera = vtkCamera()
    direction = np.array(sight.direction) / np.linalg.norm(sight.direction)
    camera.SetFocalPoint(*sight.centre_mm)
    camera.SetPosition(*(np.array(sight.centre_mm) + VIEW_DISTANCE * sight.radius_mm * direction))
    camera.SetViewUp(*sight.up)
    camera.SetViewAngle(FIELD_OF_VIEW_DEG)
    return camera


def _actor(renderer: Any, mesh: Any) -> Any:
    """Return an actor of a mesh in the colours of its points."""
    mapper = vtkPolyDataMapper()
    actor = vtkActor()
    mapper.SetInputData(mesh)
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectColorArray("rgb")
    actor.SetMapper(mapper)
    renderer.AddActor(actor)
    return actor


def _arrow(renderer: Any, axis: int) -> Any:
    """Return a unit arrow along x, y or z of the frame; hidden until its place is known."""
    actor = _actor(renderer, pv.Line((0.0, 0.0, 0.0), np.eye(3)[axis]))
    actor.GetMapper().ScalarVisibilityOff()
    actor.GetProperty().SetLineWidth(3)
    actor.GetProperty().LightingOff()
    actor.SetVisibility(False)
    return actor


def _add_layer(renderer: Any, mesh: Any, layer: Layer) -> Any:
    actor = _actor(renderer, mesh)
    look = actor.GetProperty()
    look.SetOpacity(layer.opacity)
    if layer.opacity < 1.0:  # behind coincident surfaces, which would flicker otherwise
        actor.GetMapper().SetResolveCoincidentTopologyToPolygonOffset()
        actor.GetMapper().SetRelativeCoincidentTopologyPolygonOffsetParameters(*_BEHIND)
    look.SetPointSize(layer.point_px)
    look.SetLineWidth(_LINE_PX)
    if layer.normals is None:  # has its own colour from all sides
        look.LightingOff()
    else:
        look.SetAmbient(0.3)
    if layer.segments is None and layer.triangles is None:
        look.SetRepresentationToPoints()
    return actor


def _write(mesh: Any, layer: Layer, old: Layer | None, ink: ThemeColours) -> None:
    """Write a layer's arrays into its mesh: in place while the counts stay, replaced when they
    change.
    """
    same = old is not None and len(old.points_mm) == len(layer.points_mm)
    is_darkened = layer.scale is not None and get_colour_map(ink, layer.scale) == "diverging_dark"
    rgb = darken_diverging(layer.rgb) if is_darkened else layer.rgb
    if same:
        mesh.points[:] = layer.points_mm
        mesh.GetPoints().Modified()
        mesh.point_data["rgb"][:] = rgb
        mesh.GetPointData().GetArray("rgb").Modified()
    else:
        mesh.points = np.array(layer.points_mm, dtype=np.float32)
        mesh.point_data["rgb"] = np.array(rgb)
    if not (same and _has_same_arrays(old, layer, "triangles", "segments")):
        _write_cells(mesh, layer)
    if layer.normals is not None:
        mesh.point_data.active_normals = np.array(layer.normals, dtype=np.float32)
    mesh.Modified()


def _has_same_arrays(one: Layer | None, other: Layer, *names: str) -> bool:
    return all(getattr(one, name) is getattr(other, name) for name in names)


def _write_cells(mesh: Any, layer: Layer) -> None:
    mesh.verts = np.zeros(0, dtype=np.int64)
    if layer.triangles is not None:
        mesh.faces = _join_cells(layer.triangles)
    elif layer.segments is not None:
        mesh.lines = _join_cells(layer.segments)
    else:
        mesh.verts = _join_cells(np.arange(len(layer.points_mm))[:, None])


def _join_cells(corners: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return cells (n, k) as VTK's list of number of corners and corners."""
    return np.insert(corners.astype(np.int64), 0, corners.shape[1], axis=1).ravel()
