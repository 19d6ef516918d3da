"""Shows results in the window: columns, 3D views, captions."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from typing import Literal, get_args

from app.document.evaluator import EvaluatedFrame
from app.session.state import Session
from app.views.pixel_trace import PixelProbe
from app.views.scene_geometry import compute_view_bounds, show_captions
from app.views.stage_previews import SourcePreview, StagePreview
from app.window.main_window import MainWindow
from pipeline.core.arrays import Doubles
from pipeline.core.errors import TouchError
from pipeline.core.graph import StageResult
from pipeline.stages.pose.signed_distances import NO_MESH
from pipeline.stages.stage import TRUTH
from pipeline.translation.cross_section import SectionPlane, build_plane, find_image_camera
from pipeline.translation.translate import Translation
from pipeline.translation.truth_view import ComparisonMode, TruthView
from pipeline.views.layers import Layer, ViewBounds
from pipeline.views.preview import Preview
from widgets.stages.stage_column import StageColumn
from widgets.views.scene_renderer import CameraState, SceneRenderer

PageScene = Literal["track", "task", "scene"]  # 3D views of more than a stage
_PREVIEWED = "target_depth"  # stage that an alignment drag previews
_GENERATED = "touch"  # stage that is shown with its truth under a wipe


class StageViews:
    """Shows finished values, and tracks which columns are up to date.

    Runs on the window's thread only.
    """

    def __init__(self, window: MainWindow, probe: PixelProbe) -> None:
        self._window = window
        self._columns = window.columns
        self._probe = probe
        self.scene = SceneRenderer(window.views_3d)  # opened once the window is on screen
        # column or page -> its 3D view
        self.places = {name: at for at, name in enumerate((*window.columns, *get_args(PageScene)))}
        self._requested_cameras: Mapping[str, CameraState] = {}
        self.translation: Translation | None = None  # the recording on screen
        self.comparison_mode: ComparisonMode = ""  # how columns show the truth
        self._fresh: set[str] = set()
        self._results: Mapping[str, StageResult] = {}  # on screen
        self._shown: dict[str, SourcePreview | StagePreview] = {}
        self._task_layers: Sequence[Layer] = ()
        self._page_bounds: dict[str, ViewBounds] = {}
        for name, thumbnail in window.look.filmstrip.thumbnails.items():
            self._columns[name].state_shown.connect(thumbnail.show_state)

    def show_translation(self, t: Translation, session: Session) -> None:
        """Show another recording, or the same one between other sensors."""
        old = self.translation
        self.translation = t
        window = self._window
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
        self.set_cameras(self._requested_cameras)

    def get_cameras(self) -> dict[str, CameraState]:
        """Return 3D view -> camera."""
        names = list(self.places)
        return {names[at]: camera for at, camera in self.scene.get_cameras().items()}

    def set_cameras(self, cameras: Mapping[str, CameraState], *, is_open: bool = True) -> None:
        """Set the cameras of 3D views, once the recording is open."""
        self._requested_cameras = {} if is_open else cameras
        if is_open:
            known = {
                self.places[name]: camera for name, camera in cameras.items() if name in self.places
            }
            self.scene.set_cameras(known)

    def find_section_plane(self, name: str, session: Session) -> SectionPlane | None:
        """Return the plane of the source's surface as a column's image shows it; None if it is
        empty.
        """
        opened = self.translation
        preview = self._columns[name].view.preview
        if opened is None or preview is None:
            return None
        camera = find_image_camera(preview, opened.get_sensor(name))
        return build_plane(opened, opened.get_role(name), camera, session.offsets)

    def clear_recording(self, following: str) -> None:
        """Show nothing in all columns, 3D views and tables, as a recording of this name is opened.

        "" = none is.
        """
        self.translation = None
        window = self._window
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
        for name in self._shown:
            self.scene.show_layers(self.places[name], ())
        self._shown = {}
        self._results = {}
        self._probe.set_results(self._results)

    def show_stage(self, part: SourcePreview | StagePreview, *, is_newest: bool = True) -> None:
        """Show one column's preview, layers and state.

        Unless `is_newest`, the column still counts as pending.
        """
        is_stage = isinstance(part, StagePreview)
        name = part.result.name if is_stage else "source"
        column = self._columns[name]
        card = self._window.look.filmstrip.thumbnails[name]
        self._show_preview(name, part.preview, part.truth_view if is_stage else None)
        card.show_preview(column.view.preview or part.preview)
        if is_stage:
            result = part.result
            self._results = {**self._results, name: result}
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
            card.show_feedable(feedable=NO_MESH in result.notes)
        else:
            self._results = {}  # the old results are of another frame or other parameters
            column.show_state("read", part.read_ms)
            self._probe.set_results(self._results, part.frame, part.ground_truth)
        column.view.canvas.render_now()
        self.scene.show_layers(self.places[name], part.layers)
        if is_newest:
            self._fresh.add(name)
        self._shown[name] = part

    def _get_truth_label(self, stage: str) -> str:
        """Return "with true depth" for a stage that is, or comes after, one whose truth is
        pinned.
        """
        is_pinned = False
        for method in () if self.translation is None else self.translation.methods:
            is_pinned = is_pinned or method.name == TRUTH
            if method.stage == stage and self.translation is not None and is_pinned:
                return self.translation.truth_label
        return ""

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
        truth = None if other is None else other.truth
        difference = None if other is None else other.difference_to_truth
        mode = self.comparison_mode or ("wipe" if stage == _GENERATED else "")
        self._columns[stage].view.show_compared(preview, truth, difference, mode)

    def show_wipe(self, before: Preview, after: Preview) -> None:
        """Show two target depth previews, divided by a handle, until the stage is computed
        again.
        """
        view = self._columns[_PREVIEWED].view
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
            column = self._columns[name]
            if column.state != "stale":
                column.show_state("stale")
        column = self._columns[_PREVIEWED]
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
        for column in self._list_pending().values():
            column.show_state("stale")
        self.mark_running()

    def mark_running(self) -> None:
        """Mark the first pending column as running."""
        first = next(iter(self._list_pending().values()), None)
        if first is not None and first.state == "stale":
            first.show_state("running")

    def mark_dropped(self) -> None:
        """Mark a running column as stale: the computation was dropped."""
        for column in self._list_pending().values():
            if column.state == "running":
                column.show_state("stale")

    def mark_failed(self, error: object) -> None:
        """Mark the first pending column as failed, and those after it as waiting for it."""
        text = str(error) if isinstance(error, TouchError) else "failed; see the banner"
        failed = ""
        for name, column in self._list_pending().items():
            if failed:
                column.show_state("waiting", None, (f"waits for {failed}",))
            else:
                failed = name
                column.show_state("failed", None, (text,))

    def mark_cancelled(self) -> None:
        """Mark pending columns as cancelled."""
        for column in self._list_pending().values():
            column.show_state("waiting", None, ("cancelled",))

    def reset_cameras(self, session: Session) -> None:
        """Fit the cameras of all 3D views, and update their captions."""
        if self.translation is None:
            return
        bounds = compute_view_bounds(self.translation) | self._page_bounds
        self.scene.fit_cameras(
            {self.places[name]: bound for name, bound in bounds.items()},
            linked=session.cameras_linked,
        )
        self._probe.set_scene(self.scene, session.display, self.translation)
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
        at = self.places[page]
        old = self._page_bounds.pop(page, None)
        if bounds is not None:
            self._page_bounds[page] = bounds
            if bounds != old:
                self.scene.fit_cameras({at: bounds}, linked=session.cameras_linked)
        if page == "task":
            self._task_layers = layers
        self.scene.show_layers(at, layers)

    def move_task_bodies(self, poses: Mapping[str, Doubles]) -> None:
        """Move the bodies of the rollout to these poses."""
        moved = [
            replace(layer, view_from_layer=poses.get(layer.name, layer.view_from_layer))
            for layer in self._task_layers
        ]
        self.scene.show_layers(self.places["task"], moved, is_passing=True)

    def show_step(self, stage: str, at: int) -> None:
        """Show the preview and layers of a kept step."""
        part = self._shown.get(stage)
        if isinstance(part, StagePreview) and at < len(part.step_previews):
            self._columns[stage].view.show_preview(part.step_previews[at])
            if part.step_layers[at]:
                self.scene.show_layers(self.places[stage], part.step_layers[at])

    def _find_dependent_stages(self, name: str) -> set[str]:
        """Return the stages that depend on an input."""
        changed = {name}
        for method in self.translation.methods if self.translation is not None else ():
            if changed.intersection(method.reads):
                changed.add(method.stage)
        return changed - {name}

    def _list_pending(self) -> dict[str, StageColumn]:
        """Return the visible columns that are not up to date, by name."""
        visible = self._window.visible_columns()
        return {name: self._columns[name] for name in visible if name not in self._fresh}
