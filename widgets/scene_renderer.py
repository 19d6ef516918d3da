"""Interface of the renderer of 3D layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QObject, QPointF

from pipeline.base.arrays import Doubles
from pipeline.previews.layers import Layer, ViewBounds
from widgets.view_3d import View3D

Point3 = tuple[float, float, float]
CameraState = tuple[float, ...]


class SceneRenderer(QObject):
    """Interface of a 3D renderer; itself a placeholder until OpenGL is there, or with a notice why it is not."""

    def __init__(self, views: Sequence[View3D], notice: str = "") -> None:
        super().__init__()
        self.views = tuple(views)
        for view in self.views if notice else ():
            view.show_notice(notice)

    def show_layers(self, column: int, layers: Sequence[Layer]) -> None:
        """Show exactly these layers in a view."""

    def move_layer(self, column: int, name: str, view_from_layer: Doubles) -> None:
        """Move one layer rigidly until its layers are shown again."""

    def fit_cameras(self, bounds: Mapping[int, ViewBounds], *, linked: bool) -> None:
        """Set the cameras; views of one frame share theirs when `linked`."""

    def clear_cache(self) -> None:
        """Drop cached images that will not be shown again."""

    def get_cameras(self) -> dict[int, CameraState]:
        """Return the camera of each view: position, focal point, up vector (x, y, z each), and view angle."""
        return {}

    def set_cameras(self, cameras: Mapping[int, CameraState]) -> None:
        """Set these cameras; other views keep theirs."""

    def mark_point(self, column: int, place_mm: Point3 | None) -> None:
        """Show the probe's marker in a view; None hides it."""

    def find_nearest_point(self, column: int, at: QPointF, points_mm: Doubles) -> int:
        """Return the index of the point (n, 3) at a position of a view, the foremost of those near; -1 for none."""
        del column, at, points_mm
        return -1

    def draw_pending(self) -> None:
        """Render pending views now."""

    def close(self) -> None:
        """Release all OpenGL resources."""
