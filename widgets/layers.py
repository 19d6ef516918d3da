"""What the window asks of whatever shows layers in 3D."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QObject, QPointF

from pipeline.base.arrays import Doubles
from pipeline.pictures.layers import Layer, Sight
from widgets.solid_view import SolidView

Place = tuple[float, float, float]
Camera = tuple[float, ...]


class Scene(QObject):
    """What the window asks of 3D; by itself it stands in until OpenGL is there, or says why there is none."""

    def __init__(self, views: Sequence[SolidView], notice: str = "") -> None:
        super().__init__()
        self.views = tuple(views)
        for view in self.views if notice else ():
            view.show_notice(notice)

    def show_layers(self, column: int, layers: Sequence[Layer]) -> None:
        """Show exactly these layers in a view."""

    def place(self, column: int, name: str, placed: Doubles) -> None:
        """Move one layer as a whole, until its layers are shown anew."""

    def look(self, sights: Mapping[int, Sight], *, linked: bool) -> None:
        """Set the cameras; views of one frame share theirs when `linked`."""

    def forget(self) -> None:
        """Let go of pictures of what will not be shown again."""

    def cameras(self) -> dict[int, Camera]:
        """Where each view looks from and to: position, place looked at, upwards (each x, y, z), and the angle."""
        return {}

    def turn(self, cameras: Mapping[int, Camera]) -> None:
        """Look so; other views stay as they are."""

    def mark(self, column: int, place_mm: Place | None) -> None:
        """Put the traced pixel's dot into a view, or take it away."""

    def nearest(self, column: int, at: QPointF, points_mm: Doubles) -> int:
        """Which of the points (n, 3) is seen at a place of a view, the foremost of those near; -1 for none."""
        del column, at, points_mm
        return -1

    def settle(self) -> None:
        """Draw now what was going to be drawn soon."""

    def finish(self) -> None:
        """Let go of everything OpenGL."""
