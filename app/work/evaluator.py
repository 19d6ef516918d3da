"""Where the pipeline runs for the window: in the background thread, from a session to finished pictures and layers."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from app.session.state import Session
from app.work.jobs import JobReporter
from app.work.requests import get_depth_params, make_request, open_request
from app.work.stage_previews import PreviewCache, SourcePreview, summarise_frame
from app.work.target_comparison import TargetComparison, build_target_comparison
from pipeline.base.allocator import release_free_memory
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.memo import Memo, measure_bytes
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, StageResult
from pipeline.networks.weights import Weights
from pipeline.stages.depth.photometric import DepthParams
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.error_attribution import ErrorAttribution, attribute_error
from pipeline.translation.frame_selection import find_contact_frame
from pipeline.translation.translate import Request, Translation
from pipeline.translation.truth_warnings import add_truth_warnings as with_facts
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap
from widgets.frames_model import FrameSummary

log = logging.getLogger("tactoscope")
_SEEN_BYTES = 72 * 1024 * 1024  # a dozen frames to a gel of 320 x 427, two dozen to a bubble
_ASIDE_BYTES = 16 * 1024 * 1024  # a frame or two: they must not push out what people go back to
_BESIDE_BYTES = 24 * 1024 * 1024
_OUTLINED = "target_depth"  # the slot that is compared with what the target really felt


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialFrame:
    """The frame that a session without one begins with; told ahead of everything else."""

    index: int


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluatedFrame:
    """All wanted slots are filled."""

    index: int
    settings: Session  # that it was worked out with
    frame: TactileFrame
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    summary: FrameSummary | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SummarisedFrame:
    """A frame that was worked out beside the one on screen."""

    index: int
    settings: Session  # that it was worked out with
    summary: FrameSummary


class Evaluator:
    """Holds what is open and what was worked out; used by one thread at a time."""

    def __init__(self, catalogue: Catalogue = BUILT_IN, like: Evaluator | None = None) -> None:
        """One `like` another remembers what that one has worked out."""
        self._catalogue = catalogue
        self._graph = Graph((), cache=Cache(_SEEN_BYTES)) if like is None else like.graph
        self._aside = Graph((), cache=Cache(_ASIDE_BYTES))  # of frames that nobody looks at
        self._request: Request | None = None
        self._translation: Translation | None = None
        self._as_opened: Translation | None = None  # the same, before it grew: as it was handed over
        self._drawn_bytes = () if like is None else (_ASIDE_BYTES,)  # pictures that are gone back to
        self._drawing = PreviewCache(*self._drawn_bytes)  # of what is open
        self._begins_at = 0  # of what is open
        self._opened_anew = False  # since memory was given back
        # Of what is open, so that who plays or goes back has them at once.
        self._comparisons: Memo[tuple[int, DepthParams], TargetComparison] = Memo(most_bytes=_BESIDE_BYTES)
        self._truths: Memo[int, Mapping[str, object]] = Memo(most_bytes=_BESIDE_BYTES, weigh=_weight)

    def evaluate_frame(
        self,
        session: Session,
        wanted: tuple[str, ...],
        report: JobReporter,
        *,
        compared: bool = False,
        with_truth: bool = False,
        seen: Callable[[], Translation | None] | None = None,
    ) -> EvaluatedFrame:
        """Work out a session's frame, handing over every part as soon as it is done; raises TouchError.

        `compared` also outlines what the target really felt, `with_truth` draws every slot's truth and the difference
        to it, where the recording holds them. What is open is handed over when it is opened, and again where it is not
        what the caller has `seen` by then: whoever asks anew in that moment takes nothing of the request before.
        """
        before = self._as_opened
        translation, index = self.open_frame(session, report)
        if seen is not None and before is self._as_opened is not seen():
            report.deliver(self._as_opened)
        if session.frame < 0:
            report.deliver(InitialFrame(index=index))
        started_s = time.perf_counter()
        read = self._drawing.load_frame(translation, index, session.display)
        inputs, facts = translation.build_inputs(read.frame), read.ground_truth
        ms = 1e3 * (time.perf_counter() - started_s)
        source = SourcePreview(
            frame=read.frame, ground_truth=facts, preview=read.preview, layers=(read.layer,), read_ms=ms
        )
        report.deliver(source)
        results: dict[str, StageResult] = {}
        truths = self._truths_of(translation, index) if with_truth else None

        def on_stage(result: StageResult) -> None:
            result = with_facts(result, facts)
            results[result.name] = result
            seen = compared and result.name == _OUTLINED and "depth" in results
            other = self._compared(translation, index, results["depth"].output, session) if seen else None
            report.deliver(self._drawing.draw_stage(result, results, translation, session, other, truths))

        wanted = tuple(name for name in translation.stages if name in wanted)
        self._graph = translation.build_graph(like=self._graph)
        self._graph.evaluate(wanted, inputs, session.collect_params(translation.methods), report, on_stage)
        metrics = self._drawing.compute_metrics(translation, results, index, facts)
        self._tidy(results)
        return EvaluatedFrame(
            index=index, settings=replace(session, target=translation.target.name).settings, frame=read.frame,
            results=results, metrics=metrics,
            summary=summarise_frame(results, metrics, translation) if set(results) == set(translation.stages) else None,
        )  # fmt: skip

    def _tidy(self, results: Mapping[str, StageResult]) -> None:
        """Give memory back after a recording's first frame, and after all that are worked out anew.

        What a frame takes on its way lies about in pieces, forty megabytes after a few; asking costs milliseconds.
        """
        if self._opened_anew or any(result.state == "computed" for result in results.values()):
            self._opened_anew = False
            release_free_memory()

    def open_frame(self, session: Session, report: JobReporter) -> tuple[Translation, int]:
        """What a session opens, moved by its offsets, and which of its frames it means; raises TouchError."""
        opened = self._opened(session, report)
        translation = replace(opened, alignment=session.offsets.apply_to(opened.alignment))
        return translation, self._index(session, translation)

    @property
    def graph(self) -> Graph:
        """What remembers all that was worked out of the frames people look at."""
        return self._graph

    def _index(self, session: Session, translation: Translation) -> int:
        """The session's frame, where it names one; else the one that what is open began with."""
        return min(self._begins_at if session.frame < 0 else session.frame, translation.n_frames - 1)

    def compare_with_target(self, session: Session, report: JobReporter) -> tuple[Translation, TargetComparison]:
        """The translation as it was opened, without offsets, and the session's frame on both sides.

        A drag asks for the same frame again and again: it is neither read nor looked up anew.
        """
        opened = self._opened(session, report)
        index = self._index(session, opened)
        known = self._comparisons.get((index, get_depth_params(session)))
        if known is not None:
            return opened, known
        if "depth" not in opened.stages:
            raise SettingProblem(f"the route {opened.request.route!r} has no depth to align; choose another route")
        self._graph = opened.build_graph(like=self._graph)
        params = session.collect_params(opened.methods)
        depth = self._graph.evaluate(("depth",), opened.read_inputs(index), params, report)["depth"]
        return opened, self._compared(opened, index, depth.output, session)

    def evaluate_in_background(self, session: Session, index: int, report: JobReporter) -> SummarisedFrame:
        """What a frame turns out to be that nobody looks at; one that cannot be worked out has its sentence instead."""
        opened = self._opened(session, report)
        translation = replace(opened, alignment=session.offsets.apply_to(opened.alignment))
        self._aside = translation.build_graph(like=self._aside)
        try:
            params = session.collect_params(translation.methods)
            results = self._aside.evaluate(translation.stages, translation.read_inputs(index), params, report)
            metrics = translation.compute_metrics(results, index)
            facts = translation.read_ground_truth(index)
            self._tidy(results)
            results = {name: with_facts(result, facts) for name, result in results.items()}
            summary = summarise_frame(results, metrics, translation) or FrameSummary(metrics=metrics)
        except TouchError as error:
            summary = FrameSummary(problem=str(error))
        return SummarisedFrame(
            index=index, settings=replace(session, target=translation.target.name).settings, summary=summary
        )  # fmt: skip

    def attribute_frame_error(self, session: Session, figure: str, report: JobReporter) -> ErrorAttribution | None:
        """The session's frame with its error taken apart; None where that figure is not known of it."""
        translation, index = self.open_frame(session, report)
        self._graph = translation.build_graph(like=self._graph)
        return attribute_error(
            translation, self._graph, session.collect_params(translation.methods), index, figure, report
        )

    def _compared(self, translation: Translation, index: int, depth: object, session: Session) -> TargetComparison:
        assert isinstance(depth, DepthMap)
        key = (index, get_depth_params(session))
        known = self._comparisons.get(key)
        if known is None:
            known = build_target_comparison(translation, *key, depth)
            self._forget_what_grows(translation)
            self._comparisons.put(key, known)
        return known

    def _truths_of(self, translation: Translation, index: int) -> Mapping[str, object]:
        """Kept, so that what was drawn beside it is known again."""
        known = self._truths.get(index)
        if known is None:
            known = translation.read_true_outputs(index)
            self._forget_what_grows(translation)
            self._truths.put(index, known)
        return known

    def _forget_what_grows(self, translation: Translation) -> None:
        """Only the last frame's is kept of a recording that may be set to zero anew, or forget its oldest."""
        if translation.recording.refresh is not None:
            self._forget_beside()

    def _forget_beside(self) -> None:
        self._comparisons.clear()
        self._truths.clear()

    def release_caches(self) -> None:
        """Forget what only this one remembers; what it shares with others stays."""
        self._aside.cache.clear()
        self._drawing = PreviewCache(*self._drawn_bytes)
        self._forget_beside()

    @property
    def weights_in_use(self) -> frozenset[str]:
        """The contents of the weights that the open translation's methods read."""
        opened = self._translation
        read = () if opened is None else opened.weights
        return frozenset(weights.content_digest for weights in read if isinstance(weights, Weights))

    def close(self) -> None:
        """Let go of the recording's file."""
        if self._translation is not None:
            self._translation.close()
            self._translation = self._as_opened = None

    def _opened(self, session: Session, report: JobReporter) -> Translation:
        request = make_request(session)
        if self._translation is not None and request == self._request:
            self._translation = self._translation.reload_frames()
            return self._translation
        report.step(0.0, "opening the recording")
        translation = open_request(request, self._catalogue)
        if self._translation is not None:
            self._translation.close()
        self._translation = self._as_opened = translation
        self._drawing = PreviewCache(*self._drawn_bytes)
        self._forget_beside()
        self._opened_anew = True  # the window lets go of what it showed once it is told, so after the first frame
        self._request = make_request(replace(session, target=translation.target.name))
        self._begins_at = find_contact_frame(translation.stream) if session.frame < 0 else session.frame
        if session.frame < 0:
            report.deliver(InitialFrame(index=self._begins_at))
        for note in translation.notes:
            log.info("%s", note)
        report.deliver(translation)
        return translation


def _weight(values: Mapping[str, object]) -> int:
    return sum(measure_bytes(value) for value in values.values())
