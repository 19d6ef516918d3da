"""Runs the pipeline for the window, on the background thread: from a session to previews and 3D
layers.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import replace

from app.document.requests import (
    apply_session,
    explain_unavailable,
    get_depth_params,
    make_request,
    open_request,
)
from app.session.state import Session
from app.views.stage_previews import PreviewCache, summarise_frame
from app.views.target_comparison import TargetComparison, build_target_comparison
from app.window.jobs import JobReporter
from pipeline.core.errors import SettingProblem, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.graph import Graph, StageResult
from pipeline.core.memo import Cache, Memo, measure_bytes
from pipeline.core.processes import release_free_memory
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.networks.weights import Weights
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.colour_limits import fit_display
from pipeline.translation.error_attribution import DEFAULT_METRIC, attribute_error
from pipeline.translation.force import measure_force
from pipeline.translation.frame_selection import find_contact_frame
from pipeline.translation.round_trip import measure_round_trip
from pipeline.translation.translate import Request, Translation
from pipeline.translation.truth_view import add_truth_warnings
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import make_recorded_preview
from widgets.frames.frame_summary import FrameSummary

log = logging.getLogger("tactoscope")
_CACHE_BYTES = 50 * 1024 * 1024  # 16 frames from a 320 x 427 gel to a bubble, or 9 back
# 1 or 2 background frames, kept apart from the frames on screen
_BACKGROUND_BYTES = 16 * 1024 * 1024
_TRUTH_BYTES = 24 * 1024 * 1024
_OUTLINED = "target_depth"  # stage whose preview gets the outline of the target's own touch


@frozen
class InitialView:
    """The frame chosen for a session with AUTO_FRAME, and colour limits for one that sets none."""

    index: int
    display: DisplayParams


@frozen
class EvaluatedFrame:
    """Results and metrics of one frame."""

    index: int
    settings: Session  # used for the computation
    frame: TactileFrame
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    summary: FrameSummary | None


class Evaluator:
    """Holds the open translation and its caches; used by one thread at a time."""

    def __init__(self, catalogue: Catalogue = BUILT_IN, like: Evaluator | None = None) -> None:
        """Create an evaluator; it shares the result cache of `like`."""
        self._catalogue = catalogue
        # of the frames on screen
        self.graph = Graph((), cache=Cache(_CACHE_BYTES)) if like is None else like.graph
        self._background_graph = Graph((), cache=Cache(_BACKGROUND_BYTES))
        self._request: Request | None = None
        self._translation: Translation | None = None
        # the same as it was delivered, before a live recording grew
        self._delivered: Translation | None = None
        self._preview_bytes = () if like is None else (_BACKGROUND_BYTES,)
        self._previews = PreviewCache(*self._preview_bytes)
        self._first_frame = 0  # frame to show for AUTO_FRAME
        self._contact_frame: int | None = None  # None = not searched for
        # method key -> parameter -> why it cannot act
        self.unavailable: Mapping[str, Mapping[str, str]] = {}
        self._must_release = False  # whether a recording was opened since memory was last released
        # Kept for the open recording, so that playing and stepping back need not recompute them.
        self._comparisons: Memo[tuple[int, DepthParams], TargetComparison] = Memo(
            most_bytes=_TRUTH_BYTES
        )
        self._truths: Memo[tuple[int, tuple[str, ...]], Mapping[str, object]] = Memo(
            most_bytes=_TRUTH_BYTES, weigh=_size_bytes
        )

    def evaluate_frame(
        self,
        session: Session,
        stages: tuple[str, ...],
        report: JobReporter,
        *,
        with_observation: bool = False,
        truth_of: tuple[str, ...] = (),
    ) -> EvaluatedFrame:
        """Compute `stages` of the session's frame, delivering each part as soon as it is done.

        Raises TouchError.

        `with_observation` outlines what the target sensor itself recorded, `truth_of` names
        the stages that are shown with their truth and the difference to it, where the recording
        holds them. The translation is delivered every time: a newer request drops the parts of
        an older one.
        """
        translation, index = self.open_frame(session, report)
        report.deliver(self._delivered)
        display = fit_display(translation, session.display, report, self._contact_frame)
        if session.frame < 0 or display != session.display:
            session = session.with_display(display)
            report.deliver(InitialView(index=index, display=display))
        loaded = self._previews.load_frame(translation, index, session.display)
        truth = loaded.ground_truth
        report.deliver(loaded)
        results: dict[str, StageResult] = {}
        stages = tuple(name for name in translation.stages if name in stages)
        compared = tuple(name for name in stages if name in truth_of)
        truths = self._get_true_outputs(translation, index, compared) if compared else None

        def on_stage(result: StageResult) -> None:
            result = add_truth_warnings(result, truth)
            results[result.name] = result
            other = None
            if with_observation and result.name == _OUTLINED and "depth" in results:
                depth = results["depth"].output
                other = self._get_comparison(translation, index, depth, session)
            known = truths if result.name in compared else None
            report.deliver(
                self._previews.draw_stage(result, results, translation, session, other, known)
            )

        translation.evaluate(loaded.frame, stages, report, on_stage=on_stage)
        metrics = self._previews.compute_metrics(translation, results, index, truth)
        self._release_memory(results)
        summary = None
        if set(results) == set(translation.stages):
            summary = summarise_frame(results, metrics, translation, loaded.preview)
        return EvaluatedFrame(
            index=index,
            settings=replace(session, target=translation.target.name).settings,
            frame=loaded.frame,
            results=results,
            metrics=metrics,
            summary=summary,
        )

    def _release_memory(self, results: Mapping[str, StageResult]) -> None:
        """Return freed memory to the system after the first frame of a recording and after computed
        frames.

        Fragments of temporary arrays reach 40 MB after a few frames; returning them takes
        milliseconds.
        """
        if self._must_release or any(result.state == "computed" for result in results.values()):
            self._must_release = False
            release_free_memory()

    def open_frame(self, session: Session, report: JobReporter) -> tuple[Translation, int]:
        """Open the session's translation with its offsets, and resolve its frame number.

        Raises TouchError.
        """
        translation = apply_session(session, self._open(session, report))
        return replace(translation, graph=self.graph), self._resolve_index(session, translation)

    def _resolve_index(self, session: Session, translation: Translation) -> int:
        """Return the session's frame number; for AUTO_FRAME the one detected on opening."""
        return min(
            self._first_frame if session.frame < 0 else session.frame, translation.n_frames - 1
        )

    def compare_with_target(
        self, session: Session, report: JobReporter
    ) -> tuple[Translation, TargetComparison]:
        """Return the translation without offsets, and the session's frame as both sensors recorded
        it.

        The comparison is cached, as a drag asks for the same frame many times.
        """
        opened = self._open(session, report)
        index = self._resolve_index(session, opened)
        cached = self._comparisons.get((index, get_depth_params(session, opened.methods)))
        if cached is not None:
            return opened, cached
        if "depth" not in opened.stages:
            raise SettingProblem(
                f"the route {opened.route.name!r} has no depth to align; choose another route"
            )
        translation = replace(apply_session(session, opened), graph=self.graph)
        depth = translation.evaluate(index, ["depth"], report)["depth"]
        return opened, self._get_comparison(opened, index, depth.output, session)

    def evaluate_in_background(
        self, session: Session, index: int, report: JobReporter, *, completely: bool = False
    ) -> FrameSummary:
        """Summarise a frame that is not on screen.

        A frame that fails has the error text as its summary.

        `completely` adds what takes another translation: the round trip, and the cause of the
        error.
        """
        translation = self._open_in_background(session, report)
        try:
            frame = translation.stream.frame(index)
            truth = translation.read_ground_truth(index)
            found = translation.evaluate(frame, progress=report)
            results = {name: add_truth_warnings(result, truth) for name, result in found.items()}
            metrics = translation.compute_metrics_against(results, truth)
            preview, _ = make_recorded_preview(frame, translation.source, session.display)
            summary = summarise_frame(results, metrics, translation, preview)
            if completely:
                more = measure_round_trip(results, translation, report)
                summary = replace(
                    summary,
                    metrics={**summary.metrics, **more},
                    cause=_find_cause(translation, results, index, report),
                    is_complete=True,
                )
            self._release_memory(results)
        except TouchError as error:
            return FrameSummary(problem=str(error), is_complete=True)
        return summary

    def measure_force_in_background(
        self, session: Session, index: int, metric: str, report: JobReporter
    ) -> Mapping[str, float]:
        """Measure the force of a frame, which takes its depth alone.

        `metric` is NaN where that fails.
        """
        translation = self._open_in_background(session, report)
        try:
            depth = translation.evaluate(index, ["depth"], report)
            return {metric: math.nan, **measure_force(depth, index, translation)}
        except TouchError as error:
            log.info("frame %d has no force: %s", index, error)
            return {metric: math.nan}

    def _open_in_background(self, session: Session, report: JobReporter) -> Translation:
        return replace(
            apply_session(session, self._open(session, report)), graph=self._background_graph
        )

    def _get_comparison(
        self, translation: Translation, index: int, depth: object, session: Session
    ) -> TargetComparison:
        assert isinstance(depth, DepthMap)
        key = (index, get_depth_params(session, translation.methods))
        return self._comparisons.get_or_make(
            key, lambda: build_target_comparison(translation, *key, depth)
        )

    def _get_true_outputs(
        self, translation: Translation, index: int, stages: tuple[str, ...]
    ) -> Mapping[str, object]:
        """Return the same object for the same frame and stages, which is what the preview cache
        compares by.
        """
        return self._truths.get_or_make(
            (index, stages), lambda: translation.read_true_outputs(index, stages)
        )

    def _clear_truths(self) -> None:
        self._comparisons.clear()
        self._truths.clear()

    def release_caches(self) -> None:
        """Clear the caches that no other evaluator shares."""
        self._background_graph.cache.clear()
        self._previews = PreviewCache(*self._preview_bytes)
        self._clear_truths()

    @property
    def weights_in_use(self) -> frozenset[str]:
        """Content digests of the weights that the open translation uses."""
        used = {} if self._translation is None else self._translation.weights
        return frozenset(one.content_digest for one in used.values() if isinstance(one, Weights))

    def close(self) -> None:
        """Close the recording."""
        if self._translation is not None:
            self._translation.close()
            self._translation = self._delivered = None

    def _open(self, session: Session, report: JobReporter) -> Translation:
        request = make_request(session)
        if self._translation is not None and request == self._request:
            old = self._translation
            self._translation = old.reload_frames()
            if self._translation is not old:  # zero and oldest frames of a live recording change
                self._clear_truths()
            return self._translation
        report.step(0.0, "opening the recording")
        translation = open_request(request, self._catalogue)
        is_first = self._translation is None
        if self._translation is not None:
            self._translation.close()
        self._translation = self._delivered = translation
        self._previews = PreviewCache(*self._preview_bytes)
        self._clear_truths()
        if not is_first:
            release_free_memory()  # before the new recording takes its own
        # after the first frame, when the window has dropped the old recording
        self._must_release = True
        self._request = make_request(replace(session, target=translation.target.name))
        self._contact_frame = find_contact_frame(translation.stream) if session.frame < 0 else None
        self._first_frame = session.frame if self._contact_frame is None else self._contact_frame
        if session.frame < 0:
            report.deliver(InitialView(index=self._first_frame, display=session.display))
        for note in translation.notes:
            log.info("%s", note)
        self.unavailable = explain_unavailable(translation, report)
        return translation


def _size_bytes(values: Mapping[str, object]) -> int:
    return sum(measure_bytes(value) for value in values.values())


def _find_cause(
    translation: Translation, results: Mapping[str, StageResult], index: int, report: JobReporter
) -> str:
    """Return the stage that most of a frame's error comes from, or that has the first warning
    without truth.
    """
    if "touch_depth" in translation.stages:
        shares = attribute_error(translation, index, DEFAULT_METRIC, report)
        if shares is not None:
            return shares.main_cause
    first = next((name for name, result in results.items() if result.warnings), "")
    return first and translation.catalogue.stage(first).title.lower()
