"""Shows results in the window: columns, 3D views, captions."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from typing import Literal, get_args

from app.document.evaluator import EvaluatedFrame
from app.session.state import Session
from app.views.pixel_trace import PixelProbe
from app.views.scene_geometry import ViewCameras, compute_view_bounds, show_captions
from app.views.stage_previews import SourcePreview, StagePreview
from app.window.main_window import MainWindow
from pipeline.core.arrays import Doubles
from pipeline.core.errors import TouchError
from pipeline.core.graph import StageResult
from pipeline.stages.pose.signed_distances import NO_MESH
from pipeline.stages.stage import TRUTH
from pipeline.translation.translate import Translation
from pipeline.translation.truth_view import ComparisonMode, TruthView
from pipeline.views.layers import Layer, ViewBounds
from pipeline.views.preview import Preview
from widgets.views.scene_renderer import SceneRenderer

PageScene = Literal["track", "task", "scene"]  # 3D views of more than a stage
_PREVIEWED = "target_depth"  # stage that an alignment drag previews
_GENERATED = "touch"  # stage that is shown with its truth under a wipe


class StageViews:
    """Shows finished values, and tracks which columns are up to date.

    Runs on the window's thread only.
    """

    def __init__(self, window: MainWindow, probe: PixelProbe) -> None:
        self._window = window
        self._probe = probe
        self.scene = SceneRenderer(window.views_3d)  # opened once the window is on screen
        self.cameras = ViewCameras(tuple(window.columns))
        self.translation: Translation | None = None  # the recording on screen
        self.comparison_mode: ComparisonMode = ""  # how columns show the truth
        self._layers: dict[int, tuple[Layer, ...]] = {}
        self._steps: dict[str, StagePreview] = {}  # stage -> preview, with the kept steps if any
        self._fresh: set[str] = set()
        self._order = tuple(window.columns)
        self._results: Mapping[str, StageResult] = {}  # on screen
        self._shown: dict[str, SourcePreview | StagePreview] = {}
        first = len(window.views_3d) - len(get_args(PageScene))
        self.page_views: Mapping[PageScene, int] = {
            page: first + k for k, page in enumerate(get_args(PageScene))
        }
        self._page_layers: dict[PageScene, tuple[Layer, ...]] = {}
        self._page_bounds: dict[PageScene, ViewBounds] = {}
        for name, thumbnail in window.look.filmstrip.thumbnails.items():
            window.columns[name].state_shown.connect(thumbnail.show_state)

    def show_translation(self, t: Translation, session: Session) -> None:
        """Show another recording, or the same one between other sensors."""
        (old, self.translation), window = (self.translation, t), self._window
        sensors = ", ".join(filter(None, (f"{t.source.title} → {t.target.title}", t.truth_label)))
        window.show_title(t.request.recording.name, sensors)
        window.timeline.show_frames(t.n_frames)
        if old is None or old.stream is not t.stream:
            window.frames.model.reset_frames(t.n_frames)
        window.verdict.show_verdict("", "")
        self.scene.clear_cache()
        window.source.setItemText(0, f"{t.source.title} (recorded)")
        for stage in t.catalogue.stages:
            window.columns[stage.name].enable_method(TRUTH, t.knows_truth(stage))
        window.hide_stages(frozenset(stage.name for stage in t.catalogue.stages) - set(t.stages))
        window.banner.hide()
        self.reset_cameras(session)
        self.cameras.apply_requested_cameras(self.scene)

    def clear_recording(self, following: str) -> None:
        """Show nothing in all columns, 3D views and tables, as a recording of this name is opened.

        "" = none is.
        """
        self.translation, window = None, self._window
        window.show_title(following, "")
        window.banner.hide()
        window.verdict.show_verdict("", "")
        window.look.filmstrip.show_shares({})
        window.inspector.show_figures(())
        window.error_attribution.show_empty("")
        window.frames.model.reset_frames(0)
        window.timeline.show_frames(0)
        window.source.setItemText(0, "as recorded")
        for column in window.columns.values():
            column.view.show_preview(None)
            column.warnings = ()
            column.show_state("waiting")
        for thumbnail in window.look.filmstrip.thumbnails.values():
            thumbnail.show_preview(None)
        for index in self._layers:
            self.scene.show_layers(index, ())
        self._layers = {}
        self._steps = {}
        self._shown = {}
        self._results = {}
        self._probe.set_results(self._results)

    def show_stage(self, part: SourcePreview | StagePreview, *, is_newest: bool = True) -> None:
        """Show one column's preview, layers and state.

        Unless `is_newest`, the column still counts as pending.
        """
        name = part.result.name if isinstance(part, StagePreview) else "source"
        column = self._window.columns[name]
        self._show_preview(
            name, part.preview, part.truth_view if isinstance(part, StagePreview) else None
        )
        self._window.look.filmstrip.thumbnails[name].show_preview(
            column.view.preview or part.preview
        )
        if isinstance(part, StagePreview):
            self._results = {**self._results, name: part.result}
            result = part.result
            column.show_result(
                "draft" if result.draft else result.state,
                result.ms,
                result.notes,
                result.warnings,
                ", ".join(filter(None, (result.badge, self._get_truth_label(name)))),
                is_fallback=bool(result.fallback),
            )
            self._show_who_answered(result)
            self._probe.set_results(self._results)
            card = self._window.look.filmstrip.thumbnails[name]
            card.show_feedable(feedable=NO_MESH in result.notes)
            self._steps[name] = part
        else:
            self._results = {}  # the old results are of another frame or other parameters
            column.show_state("read", part.read_ms)
            self._probe.set_results(self._results, part.frame, part.ground_truth)
        column.view.canvas.render_now()
        index = self._order.index(name)
        self._layers[index] = part.layers
        self.scene.show_layers(index, part.layers)
        if is_newest:
            self._fresh.add(name)
        self._shown[name] = part

    def _get_truth_label(self, stage: str) -> str:
        """Return "with true depth" for a stage that is, or comes after, one whose truth is
        pinned.
        """
        methods = () if self.translation is None else self.translation.methods
        before = [
            m.name
            for m in methods[: 1 + next((i for i, m in enumerate(methods) if m.stage == stage), -1)]
        ]
        return (
            self.translation.truth_label if self.translation is not None and TRUTH in before else ""
        )

    def _show_who_answered(self, result: StageResult) -> None:
        """Mark the parameters of a method that did not answer: moving them changes nothing on
        this frame.
        """
        reason = result.fallback or (
            next(iter(result.notes), "") if result.state == "skipped" else ""
        )
        if result.method is not None:
            self._window.parameters.show_unused(result.method.key, reason)

    def get_shown_stage(self, name: str) -> SourcePreview | StagePreview | None:
        """Return what a column shows; None if it is empty."""
        return self._shown.get(name)

    def _show_preview(self, stage: str, preview: Preview, other: TruthView | None) -> None:
        """Show a preview and what is known of its truth in the comparison mode.

        The recorded touch lies under a wipe of the generated one unless another mode is chosen.
        """
        truth, difference = (
            (None, None) if other is None else (other.truth, other.difference_to_truth)
        )
        mode = self.comparison_mode or ("wipe" if stage == _GENERATED else "")
        view = self._window.columns[stage].view
        view.show_compared(preview, truth, difference, mode)

    def show_wipe(self, before: Preview, after: Preview) -> None:
        """Show two target depth previews, divided by a handle, until the stage is computed
        again.
        """
        view = self._window.columns[_PREVIEWED].view
        view.show_preview(before)
        view.overlay.show_wipe(after, "before", "after")

    def show_drag_preview(self, preview: Preview, other: TruthView | None) -> None:
        """Show the target depth of a running drag, and mark the stages after it as stale."""
        changed = self._find_dependent_stages("alignment")
        self._fresh -= changed
        if self._results.keys() & changed:
            self._results = {name: r for name, r in self._results.items() if name not in changed}
            self._probe.set_results(self._results)
        for name in changed - {_PREVIEWED}:
            column = self._window.columns[name]
            if column.state != "stale":
                column.show_state("stale")
        column = self._window.columns[_PREVIEWED]
        self._show_preview(_PREVIEWED, preview, other)
        column.show_state("preview")

    def show_frame_summary(self, shown: EvaluatedFrame, *, is_comparable: bool) -> None:
        """Show the summary of a finished frame, if it `is_comparable` with the other frames."""
        if is_comparable and shown.summary is not None:
            self._window.frames.model.show_summary(shown.index, shown.summary)
            self._window.frames.show_frame(shown.index)

    def mark_pending(self, changed: Set[str] | None = None) -> None:
        """Mark the stages that depend on changed ones as pending, and these; None for all."""
        if changed is None:
            self._fresh = set()
            return
        for name in changed:
            self._fresh -= {name, *self._find_dependent_stages(name)}

    def mark_stale(self) -> None:
        """Mark pending columns as stale, and the first one as running."""
        for name in self._list_pending():
            self._window.columns[name].show_state("stale")
        self.mark_running()

    def mark_running(self) -> None:
        """Mark the first pending column as running."""
        pending = self._list_pending()
        if pending and self._window.columns[pending[0]].state == "stale":
            self._window.columns[pending[0]].show_state("running")

    def mark_dropped(self) -> None:
        """Mark a running column as stale: the computation was dropped."""
        for name in self._list_pending():
            if self._window.columns[name].state == "running":
                self._window.columns[name].show_state("stale")

    def mark_failed(self, error: object) -> None:
        """Mark the first pending column as failed, and those after it as waiting for it."""
        pending = self._list_pending()
        for name in pending:
            column = self._window.columns[name]
            text = str(error) if isinstance(error, TouchError) else "failed; see the banner"
            if name == pending[0]:
                column.show_state("failed", None, (text,))
            else:
                column.show_state("waiting", None, (f"waits for {pending[0]}",))

    def mark_cancelled(self) -> None:
        """Mark pending columns as cancelled."""
        for name in self._list_pending():
            self._window.columns[name].show_state("waiting", None, ("cancelled",))

    def reset_cameras(self, session: Session) -> None:
        """Fit the cameras of all 3D views, and update their captions."""
        if self.translation is None:
            return
        t = self.translation
        display = session.display
        bounds = compute_view_bounds(t)
        places = {self._order.index(name): bound for name, bound in bounds.items()}
        places |= {self.page_views[page]: bound for page, bound in self._page_bounds.items()}
        self.scene.fit_cameras(places, linked=session.cameras_linked)
        self._probe.set_scene(self.scene, display, t)
        self.update_captions(session)

    def update_captions(self, session: Session) -> None:
        """Update frame, axes and depth stretch in the captions of the 3D views."""
        if self.translation is not None:
            show_captions(self._window, self.translation, session.display)

    def show_page_scene(
        self, page: PageScene, layers: Sequence[Layer], bounds: ViewBounds | None, session: Session
    ) -> None:
        """Show the scene of a rollout or of a track.

        Its camera stays where the view is the same.
        """
        self._page_layers[page], old = tuple(layers), self._page_bounds.pop(page, None)
        if bounds is not None:
            self._page_bounds[page] = bounds
            if bounds != old:
                self.scene.fit_cameras(
                    {self.page_views[page]: bounds}, linked=session.cameras_linked
                )
        self.scene.show_layers(self.page_views[page], self._page_layers[page])

    def move_task_bodies(self, poses: Mapping[str, Doubles]) -> None:
        """Move the bodies of the rollout to these poses."""
        moved = [
            replace(layer, view_from_layer=poses.get(layer.name, layer.view_from_layer))
            for layer in self._page_layers.get("task", ())
        ]
        self.scene.show_layers(self.page_views["task"], moved, is_passing=True)

    def show_step(self, stage: str, at: int) -> None:
        """Show the preview and layers of a kept step."""
        part = self._steps.get(stage)
        if part is None or at >= len(part.step_previews):
            return
        self._window.columns[stage].view.show_preview(part.step_previews[at])
        if part.step_layers[at]:
            self.scene.show_layers(self._order.index(stage), part.step_layers[at])

    def _find_dependent_stages(self, name: str) -> set[str]:
        """Return the stages that depend on an input."""
        changed = {name}
        for method in self.translation.methods if self.translation is not None else ():
            if changed.intersection(method.reads):
                changed.add(method.stage)
        return changed - {name}

    def _list_pending(self) -> list[str]:
        return [name for name in self._window.visible_columns() if name not in self._fresh]
