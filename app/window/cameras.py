"""Where the 3D views look, by name: what a session keeps of them, and those that wait for something to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from widgets.scene_renderer import CameraState, SceneRenderer

_OTHER_VIEWS = ("truth", "compare_a", "compare_b")  # after those of the columns


class ViewCameras:
    """Between the names of the views and the scene."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._views = (*columns, *_OTHER_VIEWS)
        self._wanted: Mapping[str, CameraState] = {}

    def get_cameras(self, scene: SceneRenderer) -> dict[str, CameraState]:
        """View -> where it looks from and to."""
        return {self._views[column]: camera for column, camera in scene.get_cameras().items()}

    def request_cameras(self, cameras: Mapping[str, CameraState], scene: SceneRenderer | None) -> None:
        """Look so, at once or from the next `turn` on."""
        self._wanted = cameras
        self.apply_requested_cameras(scene)

    def apply_requested_cameras(self, scene: SceneRenderer | None) -> None:
        """Look as was wanted, once there are views that can; None while nothing is open."""
        if scene is not None and self._wanted and scene.get_cameras():
            places = {name: column for column, name in enumerate(self._views)}
            scene.set_cameras({places[name]: camera for name, camera in self._wanted.items() if name in places})
            self._wanted = {}
