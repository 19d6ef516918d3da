"""What the window asks of whatever shows layers in 3D."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel

from pipeline.base.arrays import Doubles
from pipeline.pictures.layers import Layer, Sight


class Scene(QLabel):
    """What the window asks of 3D; by itself it stands in until the views are there, or says why there are none."""

    def __init__(self, notice: str = "") -> None:
        super().__init__(notice)
        self.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.setWordWrap(True)

    def show_layers(self, column: int, layers: Sequence[Layer]) -> None:
        """Show exactly these layers in a sub-view."""

    def place(self, column: int, name: str, placed: Doubles) -> None:
        """Move one layer as a whole."""

    def look(self, sights: Mapping[int, Sight], *, linked: bool) -> None:
        """Set the cameras; views of one frame share theirs when `linked`."""

    def mark(self, column: int, place_mm: tuple[float, float, float] | None, radius_mm: float) -> None:
        """Put the traced pixel's dot into a sub-view, or take it away."""

    def show_columns(self, visible: Sequence[int]) -> None:
        """Give the room to these sub-views, in equal shares."""

    def settle(self) -> None:
        """Draw now what was going to be drawn soon."""

    def finish(self) -> None:
        """Let go of everything OpenGL."""
