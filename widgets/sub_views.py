"""The contents of a row of 3D sub-views: layers, cameras, lights, axes and the traced pixel's dot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyvista as pv

from pipeline.base.arrays import Doubles
from widgets.colours import AXES, TRACE
from widgets.layers import Layer, Sight


class SubViews:
    """Keeps the layers of all sub-views of one plotter; points are written in place, actors are never rebuilt."""

    def __init__(self, plotter: Any, columns: int) -> None:
        self._plotter = plotter
        self._kept: list[dict[str, tuple[Layer, Any, Any]]] = [{} for _ in range(columns)]
        self._axes = [self._added_axes(column) for column in range(columns)]
        for renderer in plotter.renderers:
            _light(renderer)
            # A camera may be shared, and layers come after it was set: every view is cut to its own, as it is drawn.
            renderer.AddObserver("StartEvent", _cut_to_its_own)
        self._tall = True
        self._marks: dict[int, tuple[tuple[float, float, float] | None, float]] = {}
        self._dots: dict[int, Any] = {}

    def show(self, column: int, layers: Sequence[Layer]) -> bool:
        """Whether anything had to change."""
        kept, changed = self._kept[column], False
        layers = [layer for layer in layers if len(layer.points_mm)]  # VTK takes no empty arrays
        wanted = {layer.name for layer in layers}
        for name, (_, _, actor) in kept.items():
            if name not in wanted and actor.GetVisibility():
                actor.SetVisibility(False)
                changed = True
        for layer in layers:
            old = kept.get(layer.name)
            if old is None:
                mesh, actor = self._added(column, layer)
            else:
                mesh, actor = old[1], old[2]
                if old[0] is layer and actor.GetVisibility():
                    continue
                _write(mesh, layer, old[0])
                actor.SetVisibility(True)
            if layer.placed is not None:
                actor.user_matrix = layer.placed
            kept[layer.name] = (layer, mesh, actor)
            changed = True
        return changed

    def place(self, column: int, name: str, placed: Doubles) -> None:
        """Move a layer that is there."""
        found = self._kept[column].get(name)
        if found is not None:
            found[2].user_matrix = placed

    def mark(self, column: int, place_mm: tuple[float, float, float] | None, radius_mm: float) -> bool:
        """Whether the dot had to change."""
        if self._marks.get(column) == (place_mm, radius_mm):
            return False
        self._marks[column] = (place_mm, radius_mm)
        actor = self._dots.get(column)
        if actor is None:
            self._plotter.subplot(0, column)
            ball = pv.Sphere(radius=1.0, theta_resolution=16, phi_resolution=12)
            actor = self._plotter.add_mesh(
                ball, color=TRACE, name="trace", pickable=False, reset_camera=False, render=False
            )
            self._dots[column] = actor
        actor.SetVisibility(place_mm is not None)
        if place_mm is not None:
            actor.SetScale(radius_mm)
            actor.SetPosition(*place_mm)
        return True

    def show_columns(self, visible: Sequence[int]) -> None:
        """Equal shares of the width for these; no room for the others."""
        for column, renderer in enumerate(self._plotter.renderers):
            renderer.SetDraw(column in visible)
            if column in visible:
                at = list(visible).index(column)
                renderer.SetViewport(at / len(visible), 0.0, (at + 1) / len(visible), 1.0)
            else:
                renderer.SetViewport(0.0, 0.0, 0.0, 0.0)

    def fit(self, width_px: int, height_px: int) -> None:
        """Make the view angle hold for the shorter side, so that the same sphere fits tall and wide sub-views."""
        shown = sum(bool(renderer.GetDraw()) for renderer in self._plotter.renderers)
        self._tall = width_px < height_px * max(1, shown)
        for renderer in self._plotter.renderers:
            renderer.camera.SetUseHorizontalViewAngle(self._tall)

    def look(self, sights: Mapping[int, Sight], linked: bool) -> None:
        """Cameras seen from the sensor's side, so that what is pushed in bulges toward the viewer."""
        shared: dict[str, Any] = {}
        for column, sight in sights.items():
            renderer = self._plotter.renderers[column]
            camera = shared.get(sight.frame) if linked else None
            if camera is None:
                camera = shared[sight.frame] = _camera(sight)
                camera.SetUseHorizontalViewAngle(self._tall)
            renderer.camera = camera
            corner = np.array(sight.centre_mm) + sight.radius_mm * np.array([-0.62, 0.72, 0.0])
            for actor in self._axes[column]:
                actor.SetPosition(*corner)
                actor.SetScale(0.25 * sight.radius_mm)
                actor.SetVisibility(True)

    def _added_axes(self, column: int) -> list[Any]:
        """Unit arrows along x, y, z of the frame; hidden until it is known where they belong."""
        self._plotter.subplot(0, column)
        actors: list[Any] = []
        for axis, colour in enumerate(AXES):
            tip = np.zeros(3)
            tip[axis] = 1.0
            actor = self._plotter.add_mesh(
                pv.Line((0.0, 0.0, 0.0), tip), color=colour, line_width=3, name=f"axis_{'xyz'[axis]}", pickable=False,
                lighting=False, reset_camera=False, render=False,
            )  # fmt: skip
            actor.SetVisibility(False)
            actors.append(actor)
        return actors

    def _added(self, column: int, layer: Layer) -> tuple[Any, Any]:
        mesh = pv.PolyData()
        _write(mesh, layer, None)
        self._plotter.subplot(0, column)
        surface = layer.triangles is not None
        actor = self._plotter.add_mesh(
            mesh, scalars="rgb", rgb=True, opacity=layer.opacity, point_size=layer.point_px, name=layer.name,
            style="surface" if surface else "points", lighting=surface, smooth_shading=False, copy_mesh=False,
            show_scalar_bar=False, reset_camera=False, render=False,
        )  # fmt: skip
        if surface:
            actor.prop.interpolation = "gouraud"
            actor.prop.ambient = 0.3
        return mesh, actor


def _camera(sight: Sight) -> Any:
    """Looking along the sensor's own view, somewhat from below, so far away that the sphere fills the width."""
    camera = pv.Camera()
    direction = np.array([0.0, 0.85, -1.0]) / np.linalg.norm([0.0, 0.85, -1.0])
    camera.focal_point = sight.centre_mm
    camera.position = tuple(np.array(sight.centre_mm) + 3.7 * sight.radius_mm * direction)
    camera.up = (0.0, -1.0, 0.0)
    camera.view_angle = 28.0
    return camera


def _cut_to_its_own(renderer: Any, _: str) -> None:
    renderer.ResetCameraClippingRange()


def _light(renderer: Any) -> None:
    """A lamp at the viewer so that colours read true, and one from the upper left so that dents cast shade."""
    renderer.remove_all_lights()
    lamp = pv.Light(light_type="headlight", intensity=0.55)
    side = pv.Light(light_type="camera light", intensity=0.6)
    side.position = (-1.0, 1.0, 0.6)
    for light in (lamp, side):
        renderer.add_light(light)


def _write(mesh: Any, layer: Layer, old: Layer | None) -> None:
    """Put a layer's arrays into its mesh: copied in place while the counts stay, set anew when they change."""
    same = old is not None and len(old.points_mm) == len(layer.points_mm)
    if same:
        mesh.points[:] = layer.points_mm
        mesh.GetPoints().Modified()
    else:
        mesh.points = np.array(layer.points_mm, dtype=np.float32)
    if not same or old is None or old.triangles is not layer.triangles:
        _write_cells(mesh, layer)
    if same:
        mesh.point_data["rgb"][:] = layer.rgb
        mesh.GetPointData().GetArray("rgb").Modified()
    else:
        mesh.point_data["rgb"] = np.array(layer.rgb)
    if layer.normals is not None:
        mesh.point_data.active_normals = np.array(layer.normals, dtype=np.float32)
    mesh.Modified()


def _write_cells(mesh: Any, layer: Layer) -> None:
    if layer.triangles is not None:
        mesh.verts = np.zeros(0, dtype=np.int64)
        faces = np.empty((len(layer.triangles), 4), dtype=np.int64)
        faces[:, 0], faces[:, 1:] = 3, layer.triangles
        mesh.faces = faces.ravel()
        return
    verts = np.empty((len(layer.points_mm), 2), dtype=np.int64)
    verts[:, 0], verts[:, 1] = 1, np.arange(len(layer.points_mm))
    mesh.verts = verts.ravel()
