"""The gizmo on the large pane of Align: drags the same six offsets as the handles of the dock."""

from PyQt6.QtCore import QPointF

from app.align.alignment import AlignmentController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from pipeline.sensors.alignment import Axis
from widgets.views.gizmo import Gizmo

_STAGE = "target_depth"  # that the alignment is judged by


class AlignmentGizmoController(Feature):
    """Places the gizmo on the centre of contact."""

    def __init__(self, controller: SessionController, alignment: AlignmentController) -> None:
        super().__init__(controller)
        self._alignment, self._panel = alignment, self._window.alignment
        self._view = controller.window.columns[_STAGE].view
        self.gizmo = Gizmo(self._view.canvas)
        self._start_offsets = alignment.offsets
        self._mm_of_px = 0.0
        alignment.contact_moved.connect(self.show_session)
        self.gizmo.grabbed.connect(self._grab)
        self.gizmo.dragged.connect(self._drag)
        self.gizmo.released.connect(self._panel.end_drag)

    def show_session(self, *_: object) -> None:
        """Place the gizmo on the centre of contact in the Align layout, else hide it."""
        opened = self._controller.views.translation
        centre_mm = self._alignment.contact_centre_mm
        preview = self._view.preview
        if (
            self._controller.session.layout.name != "align"
            or opened is None
            or centre_mm is None
            or preview is None
        ):
            self.gizmo.show_at(None)
            return
        camera = opened.target.camera
        zoom = preview.pixels.shape[1] / camera.cols
        x, y, z = (float(v) for v in centre_mm)
        self._mm_of_px = z / (camera.fx_px * zoom)
        self.gizmo.show_at(
            QPointF(
                (camera.fx_px * x / z + camera.cx_px + 0.5) * zoom,
                (camera.fy_px * y / z + camera.cy_px + 0.5) * zoom,
            )
        )

    def _grab(self) -> None:
        self._panel.begin_drag()
        self._start_offsets = self._alignment.offsets

    def _drag(self, part: str, x_px: float, y_px: float, rotation_deg: float) -> None:
        x, y, _ = self._start_offsets.translation_mm
        moves: dict[Axis, float] = {}
        if "x" in part:
            moves["x"] = x + x_px * self._mm_of_px
        if "y" in part:
            moves["y"] = y + y_px * self._mm_of_px
        if part == "rz":
            moves["rz"] = self._start_offsets.rotation_deg[2] + rotation_deg
        for axis, value in moves.items():
            self._panel.drag_axis(axis, value)
