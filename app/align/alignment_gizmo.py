"""The gizmos on image and scene: drag the same six offsets as the handles of the dock."""

from functools import partial

import numpy as np
from PyQt6.QtCore import QPointF

from app.align.alignment import AlignmentController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from pipeline.core.arrays import Doubles
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.views.scene import find_scene_places
from widgets.views.gizmo import Gizmo

_STAGE = "target_depth"  # that the alignment is judged by


class AlignmentGizmoController(Feature):
    """Places the gizmos on the centre of contact while the alignment dock is open."""

    def __init__(self, controller: SessionController, alignment: AlignmentController) -> None:
        super().__init__(controller)
        self._alignment = alignment
        self._view = controller.window.columns[_STAGE].view
        self.on_image = Gizmo(self._view.canvas, is_solid=False)
        self.on_scene = Gizmo(controller.window.scene_panel.view, is_solid=True)
        alignment.contact_moved.connect(self.show_session)
        controller.window.drawers.alignment.visibilityChanged.connect(self.show_session)
        for gizmo in (self.on_image, self.on_scene):
            gizmo.grabbed.connect(alignment.grab)
            gizmo.dragged.connect(alignment.drag_motion)
            gizmo.released.connect(controller.window.alignment.end_drag)

    def show_session(self) -> None:
        """Place the gizmos, or hide them."""
        opened = self._translation
        centre_mm = self._alignment.contact_centre_mm
        if opened is None or centre_mm is None or self._window.drawers.alignment.isHidden():
            self.on_image.show_at(None)
            self.on_scene.show_at(None)
            return
        self.on_image.show_at(
            None
            if self._view.preview is None
            else partial(self._project_on_image, opened.target.camera, centre_mm)
        )
        scene = self._views.scene
        view_from_target = find_scene_places(opened.alignment, opened.alignment).view_from_target

        def project(points_mm: Doubles) -> Doubles:
            return scene.project_points(
                self._views.places["scene"],
                rigid.apply(view_from_target, centre_mm + points_mm),
            )

        self.on_scene.show_at(project if scene.is_open else None)

    def _project_on_image(self, camera: Camera, centre_mm: Doubles, points_mm: Doubles) -> Doubles:
        """Return the positions of points about the centre on the image of the target depth."""
        preview, canvas = self._view.preview, self._view.canvas
        zoom = 1.0 if preview is None else preview.pixels.shape[1] / camera.cols
        x_px, y_px, _ = camera.project(centre_mm + points_mm)
        origin = canvas.to_screen(QPointF(0.0, 0.0))
        places = zoom * (np.stack([x_px, y_px], axis=-1) + 0.5)
        return np.array([origin.x(), origin.y()]) + canvas.scale * places
