"""Puts what the background hands over into the window: columns, 3D views, captions, timings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from app.session.state import Session
from app.window.cameras import ViewCameras
from app.window.captions import show_captions
from app.window.main_window import MainWindow
from app.window.pixel_trace import PixelProbe
from app.window.scene_geometry import compute_view_bounds
from app.work.evaluator import EvaluatedFrame
from app.work.stage_previews import SourcePreview, StagePreview
from pipeline.base.arrays import Doubles
from pipeline.base.errors import TouchError
from pipeline.engine.graph import StageResult
from pipeline.evaluation.truth_view import ComparisonMode, TruthView
from pipeline.previews.layers import Layer
from pipeline.previews.preview import Preview
from pipeline.translation.translate import Request, Translation
from widgets.preview_view import PreviewView
from widgets.scene_renderer import SceneRenderer
from widgets.steps_slider import AnyStep
from widgets.timings_panel import TimingRow

_PREVIEWED = "target_depth"  # the slot that a drag of the alignment shows on its way
_GENERATED = "touch"  # the slot whose truth demonstrations show


class StageViews:
    """Knows which columns are fresh; everything here runs on the window's thread and takes finished values."""

    def __init__(self, window: MainWindow, tracer: PixelProbe) -> None:
        self._window, self._tracer = window, tracer
        self.scene = SceneRenderer(window.views_3d)  # the 3D views
        self.cameras = ViewCameras(tuple(window.columns))
        self.translation: Translation | None = None  # the recording on screen
        self.comparison_mode: ComparisonMode = ""  # what is shown beside, or in place of, what was worked out
        self._layers: dict[int, tuple[Layer, ...]] = {}
        self._states: dict[str, StagePreview] = {}  # slot -> what holds those kept on the way to its value
        self._fresh: set[str] = set()
        self._order = tuple(window.columns)
        self._results: Mapping[str, StageResult] = {}  # on screen
        self._others: tuple[tuple[str, Translation | None], ...] = ()  # a slot of other sessions, and what they opened
        self._parts: dict[str, SourcePreview | StagePreview] = {}

    def set_scene(self, scene: SceneRenderer, session: Session) -> None:
        """Take up the 3D views, which come after the window is on screen."""
        self.scene = scene
        self.reset_cameras(session)
        self.cameras.apply_requested_cameras(scene if self.translation is not None else None)
        for column, layers in self._layers.items():
            scene.show_layers(column, layers)

    def close(self) -> None:
        """Let go of everything OpenGL."""
        self.scene.close()

    def show_translation(self, t: Translation, session: Session) -> None:
        """Another recording, or the same one between other sensors."""
        (old, self.translation), window = (self.translation, t), self._window
        window.setWindowTitle(f"{t.request.recording.name}[*] · {t.source.title} → {t.target.title} · Tactoscope")
        window.timeline.show_frames(t.n_frames)
        if old is None or old.stream is not t.stream:
            window.frames.model.reset_frames(t.n_frames)
        window.warning_line.show_warnings(())
        self.scene.clear_cache()  # what was drawn of the last one is drawn anew if it comes again
        window.source.setItemText(0, f"as recorded: {t.source.name}")
        window.hide_stages(frozenset(slot.name for slot in t.catalogue.stages) - set(t.stages))
        window.banner.hide()
        self.reset_cameras(session)
        self.cameras.apply_requested_cameras(self.scene)

    def show_stage(self, part: SourcePreview | StagePreview, *, newest: bool = True) -> None:
        """One column's picture, layers and state; one that is not of the `newest` request leaves it waiting."""
        name = part.result.name if isinstance(part, StagePreview) else "source"
        column = self._window.columns[name]
        self._show_picture(column.view, part.preview, part.truth_view if isinstance(part, StagePreview) else None)
        self._window.panes.filmstrip.thumbnails[name].show_preview(column.view.preview or part.preview)
        if isinstance(part, StagePreview):
            if name == _GENERATED:
                self._show_truth(part)
            self._results = {**self._results, name: part.result}
            column.show_result(
                "draft" if part.result.draft else part.result.state,
                part.result.ms,
                part.result.notes,
                part.result.warnings,
                part.result.fallback,
            )
            self._tracer.set_results(self._results)
            if name in self._window.steps:
                self._states[name] = part
                self._window.steps[name].show_steps(part.result.output.steps)
        else:
            self._results = {}  # those of another frame, or of other parameters
            column.show_state("read", part.read_ms)
            self._tracer.set_results(self._results, part.frame, part.ground_truth)
        self._tell_state(name)
        column.view.canvas.render_now()
        index = self._order.index(name)
        self._layers[index] = part.layers
        self.scene.show_layers(index, part.layers)
        if newest:
            self._fresh.add(name)
        self._parts[name] = part

    def get_shown_stage(self, name: str) -> SourcePreview | StagePreview | None:
        """What a column shows, with all that may be shown beside it."""
        return self._parts.get(name)

    def _show_picture(self, view: PreviewView, picture: Preview, other: TruthView | None) -> None:
        """A picture, its truth, their difference, or both in one place, where that is asked for and known."""
        if other is not None and self.comparison_mode == "truth":
            picture = other.truth
        elif other is not None and self.comparison_mode == "difference" and other.difference_to_truth is not None:
            picture = other.difference_to_truth
        view.show_preview(picture)
        if other is not None and self.comparison_mode == "wipe":
            view.overlay.show_wipe(other.truth)
        elif other is not None and self.comparison_mode == "blink":
            view.overlay.show_blink(other.truth)
        else:
            view.overlay.clear()

    def _show_truth(self, part: StagePreview) -> None:
        """The truth of the generated touch in a column of its own, which demonstrations show."""
        column, other = self._window.truth_column, part.truth_view
        if column.isHidden():
            return
        if other is None:
            column.show_state("skipped", None, ("the recording does not hold what the target really felt",))
            return
        column.view.show_preview(other.truth)
        column.show_state("read")
        self.scene.show_layers(len(self._order), other.layers)

    def _tell_state(self, name: str) -> None:
        """The filmstrip's sign."""
        column = self._window.columns[name]
        self._window.panes.filmstrip.thumbnails[name].show_state(column.state, column.warnings)

    def show_wipe(self, before: Preview, after: Preview) -> None:
        """Two pictures of the target's view, the second right of the handle, until its part comes again."""
        view = self._window.columns[_PREVIEWED].view
        view.show_preview(before)
        view.overlay.show_wipe(after)

    def show_drag_preview(self, picture: Preview, other: TruthView | None, layers: tuple[Layer, ...]) -> None:
        """The target's view of a drag on its way; what rests on it is out of date."""
        changed = self._resting_on("alignment")
        self._fresh -= changed
        if self._results.keys() & changed:
            self._results = {name: r for name, r in self._results.items() if name not in changed}
            self._tracer.set_results(self._results)
        for name in changed - {_PREVIEWED}:
            column = self._window.columns[name]
            if column.state != "stale":
                column.show_state("stale")
        column = self._window.columns[_PREVIEWED]
        self._show_picture(column.view, picture, other)
        column.show_state("preview")
        self.scene.show_layers(self._order.index(_PREVIEWED), layers)

    def show_frame_summary(self, shown: EvaluatedFrame, *, comparable: bool) -> None:
        """Timings of a frame that is through, and its summary where that is `comparable` with those of the others."""
        if comparable and shown.summary is not None:
            self._window.frames.model.show_summary(shown.index, shown.summary)
            self._window.frames.show_frame(shown.index)
        if self.translation is not None:
            slot = self.translation.catalogue.stage
            common = self._window.frames.model.common_warnings
            here = [(slot(key).title, doubt) for key, r in shown.results.items() for doubt in r.warnings]
            # What is doubted of every frame comes last: it is no news.
            here.sort(key=lambda pair: f"{pair[0].lower()}: {pair[1]}" in common)
            self._window.warning_line.show_warnings(here)
            rows = [
                TimingRow(title=slot(r.name).title, state=r.state, time_ms=r.ms, notes=r.notes)
                for r in shown.results.values()
            ]
            self._window.timings.show_rows(tuple(rows))

    def mark_all_pending(self) -> None:
        """Nothing on screen is fresh any more."""
        self._fresh = set()

    def mark_stale(self) -> None:
        """Dim what has not been replaced in time, and say where the work is."""
        for name in self._unfinished():
            self._window.columns[name].show_state("stale")
            self._tell_state(name)
        self.mark_running()

    def mark_running(self) -> None:
        """The first column without a fresh result is the one being worked on."""
        waiting = self._unfinished()
        if waiting and self._window.columns[waiting[0]].state == "stale":
            self._window.columns[waiting[0]].show_state("running")
            self._tell_state(waiting[0])

    def mark_dropped(self) -> None:
        """Nothing is being worked on for now: what said so is only old."""
        for name in self._unfinished():
            if self._window.columns[name].state == "running":
                self._window.columns[name].show_state("stale")
                self._tell_state(name)

    def mark_failed(self, error: object) -> None:
        """The first column without a fresh result failed, those after it wait for it."""
        waiting = self._unfinished()
        for name in waiting:
            column = self._window.columns[name]
            text = str(error) if isinstance(error, TouchError) else "failed, see above"
            if name == waiting[0]:
                column.show_state("failed", None, (text,))
            else:
                column.show_state("waiting", None, (f"waits for {waiting[0]}",))
            self._tell_state(name)

    def mark_cancelled(self) -> None:
        """What has not come will not come."""
        for name in self._unfinished():
            self._window.columns[name].show_state("waiting", None, ("cancelled",))
            self._tell_state(name)

    def reset_cameras(self, session: Session) -> None:
        """Set the cameras anew, and say what each 3D view shows."""
        if self.translation is None:
            return
        t, display = self.translation, session.display
        seen = compute_view_bounds(t)
        places = {self._order.index(name): sight for name, sight in seen.items()}
        if _GENERATED in seen:
            places[len(self._order)] = seen[_GENERATED]
        for k, (slot, other) in enumerate(self._others):
            if slot in seen and other is not None:
                places[len(self._order) + 1 + k] = compute_view_bounds(other)[slot]
        self.scene.fit_cameras(places, linked=session.cameras_linked)
        self._tracer.set_scene(self.scene, display, t)
        self.update_captions(session)

    def update_captions(self, session: Session) -> None:
        """Say which frame and stretch each 3D view has, its axes in the colours that are on."""
        if self.translation is not None:
            show_captions(self._window, self.translation, session.display)

    def show_variants(
        self, stage: str, others: Sequence[tuple[tuple[Layer, ...], Translation | None]], session: Session
    ) -> None:
        """A slot of other sessions, in 3D views of their own, which look from where the columns do."""
        old, self._others = self._others, tuple((stage, other) for _, other in others)
        if [_opened_as(*pair) for pair in old] != [_opened_as(*pair) for pair in self._others]:
            self.reset_cameras(session)
        for k, (layers, _) in enumerate(others):
            self.scene.show_layers(len(self._order) + 1 + k, layers)
            self._layers[len(self._order) + 1 + k] = layers

    def show_step(self, stage: str, _step: AnyStep, at: int) -> None:
        """Show a state's picture, and its layers where it has some."""
        kept = self._states.get(stage)
        if kept is None or at >= len(kept.step_previews):
            return
        self._window.columns[stage].view.show_preview(kept.step_previews[at])
        if kept.step_layers[at]:
            self.scene.show_layers(self._order.index(stage), kept.step_layers[at])

    def show_pose(self, sensor_from_object: Doubles, picture: Preview | None) -> None:
        """Put the object elsewhere, with the picture that goes with it, until the slot is filled anew."""
        self.scene.move_layer(self._order.index("pose"), "object", sensor_from_object)
        if picture is not None:
            self._window.columns["pose"].view.show_preview(picture)

    def show_only(self, name: str | None) -> None:
        """One slot alone, or all of the route for None."""
        self._window.show_only(name)

    def _resting_on(self, name: str) -> set[str]:
        """The slots that change with an input."""
        changed = {name}
        for method in self.translation.methods if self.translation is not None else ():
            if changed.intersection(method.reads):
                changed.add(method.stage)
        return changed - {name}

    def _unfinished(self) -> list[str]:
        return [name for name in self._window.visible_columns() if name not in self._fresh]


def _opened_as(stage: str, other: Translation | None) -> tuple[str, Request | None]:
    """What a view of another session looks at: the same while its frames go by and its alignment is dragged."""
    return stage, None if other is None else other.request
