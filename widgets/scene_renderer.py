"""What the window asks of whatever shows layers in 3D."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QObject, QPointF

from pipeline.base.arrays import Doubles
from pipeline.previews.layers import Layer, ViewBounds
from widgets.view_3d import View3D

Point3 = tuple[float, float, float]
CameraState = tuple[float, ...]


class SceneRenderer(QObject):
    """What the window asks of 3D; by itself it stands in until OpenGL is there, or says why there is none."""

    def __init__(self, views: Sequence[View3D], notice: str = "") -> None:
        super().__init__()
        self.views = tuple(views)
        for view in self.views if notice else ():
            view.show_notice(notice)

    def show_layers(self, column: int, layers: Sequence[Layer]) -> None:
        """Show exactly these layers in a view."""

    def move_layer(self, column: int, name: str, view_from_layer: Doubles) -> None:
        """Move one layer as a whole, until its layers are shown anew."""

    def fit_cameras(self, bounds: Mapping[int, ViewBounds], *, linked: bool) -> None:
        """Set the cameras; views of one frame share theirs when `linked`."""

    def clear_cache(self) -> None:
        """Let go of pictures of what will not be shown again."""

    def get_cameras(self) -> dict[int, CameraState]:
        """Where each view looks from and to: position, place looked at, upwards (each x, y, z), and the angle."""
        return {}

    def set_cameras(self, cameras: Mapping[int, CameraState]) -> None:
        """Look so; other views stay as they are."""

    def mark_point(self, column: int, place_mm: Point3 | None) -> None:
        """Put the traced pixel's dot into a view, or take it away."""

    def find_nearest_point(self, column: int, at: QPointF, points_mm: Doubles) -> int:
        """Which of the points (n, 3) is seen at a place of a view, the foremost of those near; -1 for none."""
        del column, at, points_mm
        return -1

    def draw_pending(self) -> None:
        """Draw now what was going to be drawn soon."""

    def close(self) -> None:
        """Let go of everything OpenGL."""
