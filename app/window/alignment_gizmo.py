"""The gizmo over *Align*'s large pane: what is dragged there are the same six offsets as the handles of the dock."""

from __future__ import annotations

from PyQt6.QtCore import QObject, QPointF

from app.window.alignment import AlignmentController
from app.window.session_controller import SessionController
from pipeline.sensors.offsets import Axis
from widgets.gizmo import Gizmo

_WHERE = "target_depth"  # the slot that alignments are judged by


class AlignmentGizmoController(QObject):
    """Stands on the middle of the contact, wherever it was moved to."""

    def __init__(self, controller: SessionController, aligning: AlignmentController) -> None:
        super().__init__(controller)
        self._controller, self._aligning, self._panel = controller, aligning, controller.window.alignment
        self._view = controller.window.columns[_WHERE].view
        self.gizmo = Gizmo(self._view.canvas)
        self._begun, self._mm_of_px = aligning.offsets, 0.0
        aligning.contact_moved.connect(self._place)
        controller.session_shown.connect(self._session_shown)
        self.gizmo.grabbed.connect(self._grab)
        self.gizmo.dragged.connect(self._drag)
        self.gizmo.released.connect(self._panel.end_drag)

    def _session_shown(self, _: object) -> None:
        self._place()

    def _place(self) -> None:
        opened, middle, picture = (
            self._controller.views.translation,
            self._aligning.contact_centre_mm,
            self._view.preview,
        )
        if self._controller.session.layout.name != "align" or opened is None or middle is None or picture is None:
            self.gizmo.show_at(None)
            return
        camera = opened.target.camera
        times = picture.pixels.shape[1] / camera.cols
        x, y, z = (float(v) for v in middle)
        self._mm_of_px = z / (camera.fx_px * times)
        self.gizmo.show_at(QPointF(
            (camera.fx_px * x / z + camera.cx_px + 0.5) * times, (camera.fy_px * y / z + camera.cy_px + 0.5) * times
        ))  # fmt: skip

    def _grab(self) -> None:
        self._panel.begin_drag()
        self._begun = self._aligning.offsets

    def _drag(self, part: str, x_px: float, y_px: float, turned_deg: float) -> None:
        x, y, _ = self._begun.translation_mm
        moves: dict[Axis, float] = {}
        if "x" in part:
            moves["x"] = x + x_px * self._mm_of_px
        if "y" in part:
            moves["y"] = y + y_px * self._mm_of_px
        if part == "rz":
            moves["rz"] = self._begun.rotation_deg[2] + turned_deg
        for axis, value in moves.items():
            self._panel.drag_axis(axis, value)
