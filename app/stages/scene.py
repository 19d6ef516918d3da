"""The scene: both sensors and the object from what the stages on screen show, still or as the
press in motion.
"""

import time
from collections.abc import Sequence
from functools import partial

from PyQt6.QtCore import QEvent, QPointF, Qt, QTimer

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.scene_geometry import show_scene_caption
from app.views.stage_previews import StagePreview
from pipeline.sensors.alignment import Offsets
from pipeline.views.layers import Layer
from pipeline.views.press_motion import DURATION_S, PressMotion
from pipeline.views.scene import (
    MEMBRANE_STAGES,
    SCENE_VIEWS,
    ScenePlaces,
    compute_scene_bounds,
    find_scene_places,
    make_scene_layers,
)
from pipeline.views.scene_measure import SceneMeasure
from widgets.style.base import EventListener
from widgets.style.icons import make_command_icon

_TICK_MS = 60  # between two images of the motion
_PLAY_KEYS = frozenset({Qt.Key.Key_Space, Qt.Key.Key_Escape})
_IDLE_KEYS = frozenset({Qt.Key.Key_Space})


class SceneController(Feature):
    """Places the finished layers of the stages in the alignment frame while a pane shows them."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._dragged: Offsets | None = None  # of a drag that has not ended
        self._view = self._window.scene_panel.view
        self._place = controller.views.places["scene"]
        scene = controller.views.scene
        self._layers: tuple[Layer, ...] = ()
        self._places: ScenePlaces | None = None
        self._motion: PressMotion | None = None
        self._time = 0.0  # of the motion, from 0 to 1
        self._shown_s = 0.0  # when it was last shown
        self._timer = QTimer(self)
        self._timer.setInterval(_TICK_MS)
        self._timer.timeout.connect(self._move_on)
        self._measure = SceneMeasure()
        actions = self._actions
        self._play, self._measures = actions["press_motion"], actions["scene_measure"]
        scene.show_scale_bar(self._place)
        # a frame that no stage can read has both sensors and its image
        EventListener(self._window.banner, self._show, QEvent.Type.Show)
        self._play.setIcon(make_command_icon("play"))
        self._play.toggled.connect(self._toggle_motion)
        self._play.triggered.connect(lambda _on=False: self._view.setFocus())
        self._window.connect_command("cancel", self._stop_motion)
        self._view.key_pressed.connect(self._handle_key)
        self._view.clicked.connect(self._measure_point)
        self._measures.toggled.connect(self._clear_measure)
        actions["scene_orthographic"].toggled.connect(self._set_orthographic)
        for name in SCENE_VIEWS:
            self._window.connect_command(f"scene_{name}", partial(self._look_from, name))

    @property
    def is_moving(self) -> bool:
        """Whether the press is shown in motion, playing or paused."""
        return self._motion is not None

    def show_session(self) -> None:
        """Show the scene once a pane is given to it; nothing until a recording is open."""
        views = self._views
        if views.translation is None:
            self._stop_motion()
            self._layers, self._places = (), None
            views.show_page_scene("scene", (), None, self._session)
            views.scene.label_points(self._place, {})
        elif self._controller.is_idle:
            self.show_frame()

    def show_frame(self) -> None:
        """Show it, unless a drag shows the scene."""
        if self._dragged is None:
            self._show()

    def show_drag(self, offsets: Offsets | None, target_depth: Sequence[Layer] | None) -> None:
        """Show the source where a drag has it, and what the target sees of it there.

        None: the drag has ended.
        """
        self._dragged = offsets
        if offsets is not None:
            self._show(target_depth)

    def _show(self, target_depth: Sequence[Layer] | None = None) -> None:
        views, session = self._views, self._session
        opened, layout = views.translation, session.layout
        is_shown = layout.name == "align" or any(dims == "scene" for _, dims in layout.panes)
        if opened is None or not is_shown:
            return
        source, target, alignment = opened.source, opened.target, opened.alignment
        parts = {name: views.get_shown_stage(name) for name in (*opened.stages, "source")}
        shown = {name: part.layers for name, part in parts.items() if part is not None}
        if target_depth is not None:  # of the others none is of this alignment
            shown = {"source": shown.get("source", ()), "target_depth": tuple(target_depth)}
        offsets = self._dragged or session.offsets
        self._places = find_scene_places(alignment, offsets.apply_to(alignment))
        recorded = [_find_recorded(parts.get(name)) for name in MEMBRANE_STAGES]
        first = next(filter(None, recorded), ())
        self._layers = make_scene_layers(shown, source, target, self._places, first)
        bounds = compute_scene_bounds(source, target, alignment)
        if self._motion is not None:
            self._motion = PressMotion(self._layers, source, target, self._places)
            self._show_motion()
        else:
            views.show_page_scene("scene", (*self._layers, *self._measure.layers), bounds, session)
            show_scene_caption(self._window, opened, session.display)
        self._show_labels()

    def _show_labels(self) -> None:
        if self._places is not None:
            labels = {**self._places.labels, **self._measure.labels}
            self._views.scene.label_points(self._place, labels)

    def _handle_key(self, key: int) -> None:
        if key == Qt.Key.Key_Escape:
            self._stop_motion()
        else:
            self._play.toggle()

    def _toggle_motion(self, on: bool) -> None:
        """Play on, or pause; without a scene there is nothing to play."""
        opened = self._translation
        self._play.setIcon(make_command_icon("pause" if on else "play"))
        if not on:
            self._timer.stop()
        elif opened is None or self._places is None or not self._view.isVisible():
            self._play.setChecked(False)
            self._window.say("no scene to play; show one in a pane: scene, at its upper right")
        else:
            if self._motion is None:
                self._motion = PressMotion(self._layers, opened.source, opened.target, self._places)
                self._time = 0.0
            self._view.keys = _PLAY_KEYS
            self._shown_s = time.monotonic()
            self._timer.start()

    def _stop_motion(self) -> None:
        """Show the frame itself again."""
        self._play.setChecked(False)
        if self._motion is not None:
            self._motion = None
            self._view.keys = _IDLE_KEYS
            self._show()

    def _move_on(self) -> None:
        now_s = time.monotonic()
        self._time = (self._time + (now_s - self._shown_s) / DURATION_S) % 1.0
        self._shown_s = now_s
        if self._view.isVisible():
            self._show_motion()
        else:
            self._stop_motion()

    def _show_motion(self) -> None:
        opened = self._translation
        if self._motion is None or opened is None:
            return
        layers = (*self._motion.make_layers(self._time), *self._measure.layers)
        self._views.scene.show_layers(self._place, layers, is_passing=True)
        text = self._motion.describe(self._time)
        show_scene_caption(self._window, opened, self._session.display, text)

    def _set_orthographic(self, on: bool) -> None:
        self._views.scene.set_orthographic(self._place, on=on)

    def _look_from(self, name: str) -> None:
        if self._places is not None:
            direction, up = self._places.find_view(name)
            self._views.scene.look_from(self._place, direction, up)

    def _measure_point(self, at: QPointF) -> None:
        """Take a clicked point as the next end of what is measured."""
        opened = self._translation
        found = self._views.scene.find_surface_point(self._place, at)
        if self._measures.isChecked() and found and opened and self._places:
            sensors = opened.source, opened.target
            self._measure = self._measure.add_point(
                *found, self._places, sensors, self._session.display
            )
            self._show()

    def _clear_measure(self) -> None:
        self._measure = SceneMeasure()
        self._show()


def _find_recorded(part: object) -> tuple[Layer, ...]:
    """Return the membrane that the target itself recorded, where the stage shows its truth."""
    if not isinstance(part, StagePreview) or part.truth_view is None:
        return ()
    name = part.result.name
    return tuple(layer for layer in part.truth_view.layers if layer.name == name)
