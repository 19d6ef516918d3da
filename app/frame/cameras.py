"""Where the 3D views look, by name: what a session keeps of them, and those that wait for something to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from widgets.layers import Camera, Scene

_OTHER_VIEWS = ("truth", "compare_a", "compare_b")  # after those of the columns


class Cameras:
    """Between the names of the views and the scene."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._views = (*columns, *_OTHER_VIEWS)
        self._wanted: Mapping[str, Camera] = {}

    def of(self, scene: Scene) -> dict[str, Camera]:
        """View -> where it looks from and to."""
        return {self._views[column]: camera for column, camera in scene.cameras().items()}

    def want(self, cameras: Mapping[str, Camera], scene: Scene | None) -> None:
        """Look so, at once or from the next `turn` on."""
        self._wanted = cameras
        self.turn(scene)

    def turn(self, scene: Scene | None) -> None:
        """Look as was wanted, once there are views that can; None while nothing is open."""
        if scene is not None and self._wanted and scene.cameras():
            places = {name: column for column, name in enumerate(self._views)}
            scene.turn({places[name]: camera for name, camera in self._wanted.items() if name in places})
            self._wanted = {}
