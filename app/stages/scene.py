"""The scene of *Look*: both sensors and the object, from what the stages on screen show."""

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.state import Session
from app.views.scene_geometry import show_scene_caption
from app.views.stage_previews import StagePreview
from pipeline.views.layers import Layer
from pipeline.views.scene import (
    MEMBRANE_STAGES,
    compute_scene_bounds,
    find_scene_labels,
    make_scene_layers,
)


class SceneController(Feature):
    """Places the finished layers of the stages in the alignment frame while a pane shows them."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        controller.frame_shown.connect(self._show_frame)

    def show_session(self, session: Session) -> None:
        """Show the scene once a pane is given to it; nothing without a recording."""
        if session.recording is None:
            self._controller.views.show_page_scene("scene", (), None, session)
        elif self._controller.is_idle:
            self._show_frame()

    def _show_frame(self, _index: int = 0) -> None:
        views, session = self._controller.views, self._controller.session
        opened = views.translation
        if opened is None or not any(dims == "scene" for _, dims in session.layout.panes):
            return
        parts = {
            name: part
            for name in (*opened.stages, "source")
            if (part := views.get_shown_stage(name)) is not None
        }
        alignment = session.offsets.apply_to(opened.alignment)
        layers = make_scene_layers(
            {name: part.layers for name, part in parts.items()},
            opened.source,
            opened.target,
            alignment,
            next(filter(None, (_find_recorded(parts.get(name)) for name in MEMBRANE_STAGES)), ()),
        )
        bounds = compute_scene_bounds(opened.source, opened.target, opened.alignment)
        views.show_page_scene("scene", layers, bounds, session)
        views.scene.label_points(views.page_views["scene"], find_scene_labels(alignment))
        show_scene_caption(self._window, opened, session.display)


def _find_recorded(part: object) -> tuple[Layer, ...]:
    """Return the membrane that the target itself recorded, where the stage shows its truth."""
    if not isinstance(part, StagePreview) or part.truth_view is None:
        return ()
    name = part.result.name
    return tuple(layer for layer in part.truth_view.layers if layer.name == name)
