"""Cameras of the 3D views by name, as the session stores them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from widgets.scene_renderer import CameraState, SceneRenderer

_OTHER_VIEWS = ("truth", "compare_a", "compare_b", "track", "task")  # after the views of the columns


class ViewCameras:
    """Translates view names to positions in the scene; keeps requested cameras until the views exist."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._views = (*columns, *_OTHER_VIEWS)
        self._requested: Mapping[str, CameraState] = {}

    def get_cameras(self, scene: SceneRenderer) -> dict[str, CameraState]:
        """Return view -> camera."""
        return {self._views[column]: camera for column, camera in scene.get_cameras().items()}

    def request_cameras(self, cameras: Mapping[str, CameraState], scene: SceneRenderer | None) -> None:
        """Set cameras now, or at the next `apply_requested_cameras`."""
        self._requested = cameras
        self.apply_requested_cameras(scene)

    def apply_requested_cameras(self, scene: SceneRenderer | None) -> None:
        """Set the requested cameras if the scene has views; `scene` is None while nothing is open."""
        if scene is not None and self._requested and scene.get_cameras():
            places = {name: column for column, name in enumerate(self._views)}
            scene.set_cameras({places[name]: camera for name, camera in self._requested.items() if name in places})
            self._requested = {}
