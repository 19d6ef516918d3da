"""Where the pipeline runs for the window: in the background thread, from a session to finished pictures and layers."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from app.session.state import Session
from app.work.comparison import Comparison, comparison_of
from app.work.drawing import Drawing, SourceShown, summary_of
from app.work.jobs import Report
from app.work.opening import depth_params, open_request, request_of
from pipeline.base.allocator import give_back
from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.memo import Memo, size_bytes
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, StageResult
from pipeline.networks.weights import Weights
from pipeline.stages.depth.stage import DepthParams
from pipeline.translation.blame import Blame, blame
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.translation.doubts import with_truth as with_facts
from pipeline.translation.touched import touched_frame
from pipeline.translation.translate import Request, Translation
from pipeline.values.frames import TactileFrame
from pipeline.values.results import DepthMap
from widgets.frames_model import FrameSummary

log = logging.getLogger("tactoscope")
_SEEN_BYTES = 72 * 1024 * 1024  # a dozen frames to a gel of 320 x 427, two dozen to a bubble
_ASIDE_BYTES = 16 * 1024 * 1024  # a frame or two: they must not push out what people go back to
_BESIDE_BYTES = 24 * 1024 * 1024
_OUTLINED = "view"  # the slot that is compared with what the target really felt


@dataclass(frozen=True, slots=True, kw_only=True)
class BeginsAt:
    """The frame that a session without one begins with; told ahead of everything else."""

    index: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameShown:
    """All wanted slots are filled."""

    index: int
    settings: Session  # that it was worked out with
    frame: TactileFrame
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    summary: FrameSummary | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameKnown:
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
        self._drawing = Drawing(*self._drawn_bytes)  # of what is open
        self._begins_at = 0  # of what is open
        self._opened_anew = False  # since memory was given back
        # Of what is open, so that who plays or goes back has them at once.
        self._comparisons: Memo[tuple[int, DepthParams], Comparison] = Memo(most_bytes=_BESIDE_BYTES)
        self._truths: Memo[int, Mapping[str, object]] = Memo(most_bytes=_BESIDE_BYTES, weigh=_weight)

    def show(
        self,
        session: Session,
        wanted: tuple[str, ...],
        report: Report,
        *,
        compared: bool = False,
        with_truth: bool = False,
        seen: Callable[[], Translation | None] | None = None,
    ) -> FrameShown:
        """Work out a session's frame, handing over every part as soon as it is done; raises TouchError.

        `compared` also outlines what the target really felt, `with_truth` draws every slot's truth and the difference
        to it, where the recording holds them. What is open is handed over when it is opened, and again where it is not
        what the caller has `seen` by then: whoever asks anew in that moment takes nothing of the request before.
        """
        before = self._as_opened
        translation, index = self.at(session, report)
        if seen is not None and before is self._as_opened is not seen():
            report.hand_over(self._as_opened)
        if session.frame < 0:
            report.hand_over(BeginsAt(index=index))
        started_s = time.perf_counter()
        read = self._drawing.frame(translation, index, session.display)
        inputs, facts = translation.inputs_of(read.frame), read.facts
        ms = 1e3 * (time.perf_counter() - started_s)
        source = SourceShown(frame=read.frame, facts=facts, picture=read.picture, layers=(read.layer,), ms=ms)
        report.hand_over(source)
        results: dict[str, StageResult] = {}
        truths = self._truths_of(translation, index) if with_truth else None

        def on_stage(result: StageResult) -> None:
            result = with_facts(result, facts)
            results[result.name] = result
            seen = compared and result.name == _OUTLINED and "depth" in results
            other = self._compared(translation, index, results["depth"].output, session) if seen else None
            report.hand_over(self._drawing.draw(result, results, translation, session, other, truths))

        wanted = tuple(name for name in translation.slots if name in wanted)
        self._graph = translation.graph(like=self._graph)
        self._graph.evaluate(wanted, inputs, session.params_for(translation.methods), report, on_stage)
        metrics = self._drawing.figures(translation, results, index, facts)
        self._tidy(results)
        return FrameShown(
            index=index, settings=replace(session, target=translation.target.name).settings, frame=read.frame,
            results=results, metrics=metrics,
            summary=summary_of(results, metrics, translation) if set(results) == set(translation.slots) else None,
        )  # fmt: skip

    def _tidy(self, results: Mapping[str, StageResult]) -> None:
        """Give memory back after a recording's first frame, and after all that are worked out anew.

        What a frame takes on its way lies about in pieces, forty megabytes after a few; asking costs milliseconds.
        """
        if self._opened_anew or any(result.state == "computed" for result in results.values()):
            self._opened_anew = False
            give_back()

    def at(self, session: Session, report: Report) -> tuple[Translation, int]:
        """What a session opens, moved by its offsets, and which of its frames it means; raises TouchError."""
        opened = self._opened(session, report)
        translation = replace(opened, alignment=session.offsets.applied(opened.alignment))
        return translation, self._index(session, translation)

    @property
    def graph(self) -> Graph:
        """What remembers all that was worked out of the frames people look at."""
        return self._graph

    def _index(self, session: Session, translation: Translation) -> int:
        """The session's frame, where it names one; else the one that what is open began with."""
        return min(self._begins_at if session.frame < 0 else session.frame, translation.n_frames - 1)

    def comparison(self, session: Session, report: Report) -> tuple[Translation, Comparison]:
        """The translation as it was opened, without offsets, and the session's frame on both sides.

        A drag asks for the same frame again and again: it is neither read nor looked up anew.
        """
        opened = self._opened(session, report)
        index = self._index(session, opened)
        known = self._comparisons.get((index, depth_params(session)))
        if known is not None:
            return opened, known
        if "depth" not in opened.slots:
            raise SettingProblem(f"the route {opened.request.route!r} has no depth to align; choose another route")
        self._graph = opened.graph(like=self._graph)
        params = session.params_for(opened.methods)
        depth = self._graph.evaluate(("depth",), opened.inputs(index), params, report)["depth"]
        return opened, self._compared(opened, index, depth.output, session)

    def known(self, session: Session, index: int, report: Report) -> FrameKnown:
        """What a frame turns out to be that nobody looks at; one that cannot be worked out has its sentence instead."""
        opened = self._opened(session, report)
        translation = replace(opened, alignment=session.offsets.applied(opened.alignment))
        self._aside = translation.graph(like=self._aside)
        try:
            params = session.params_for(translation.methods)
            results = self._aside.evaluate(translation.slots, translation.inputs(index), params, report)
            metrics = translation.metrics(results, index)
            facts = translation.facts(index)
            self._tidy(results)
            results = {name: with_facts(result, facts) for name, result in results.items()}
            summary = summary_of(results, metrics, translation) or FrameSummary(figures=metrics)
        except TouchError as error:
            summary = FrameSummary(problem=str(error))
        return FrameKnown(
            index=index, settings=replace(session, target=translation.target.name).settings, summary=summary
        )  # fmt: skip

    def blamed(self, session: Session, figure: str, report: Report) -> Blame | None:
        """The session's frame with its error taken apart; None where that figure is not known of it."""
        translation, index = self.at(session, report)
        self._graph = translation.graph(like=self._graph)
        return blame(translation, self._graph, session.params_for(translation.methods), index, figure, report)

    def _compared(self, translation: Translation, index: int, depth: object, session: Session) -> Comparison:
        assert isinstance(depth, DepthMap)
        key = (index, depth_params(session))
        known = self._comparisons.get(key)
        if known is None:
            known = comparison_of(translation, *key, depth)
            self._forget_what_grows(translation)
            self._comparisons.put(key, known)
        return known

    def _truths_of(self, translation: Translation, index: int) -> Mapping[str, object]:
        """Kept, so that what was drawn beside it is known again."""
        known = self._truths.get(index)
        if known is None:
            known = translation.truths(index)
            self._forget_what_grows(translation)
            self._truths.put(index, known)
        return known

    def _forget_what_grows(self, translation: Translation) -> None:
        """Only the last frame's is kept of a recording that may be set to zero anew, or forget its oldest."""
        if translation.recording.now is not None:
            self._forget_beside()

    def _forget_beside(self) -> None:
        self._comparisons.clear()
        self._truths.clear()

    def let_go(self) -> None:
        """Forget what only this one remembers; what it shares with others stays."""
        self._aside.cache.clear()
        self._drawing = Drawing(*self._drawn_bytes)
        self._forget_beside()

    @property
    def weights_in_use(self) -> frozenset[str]:
        """The contents of the weights that the open translation's methods read."""
        opened = self._translation
        read = () if opened is None else opened.weights
        return frozenset(weights.content for weights in read if isinstance(weights, Weights))

    def close(self) -> None:
        """Let go of the recording's file."""
        if self._translation is not None:
            self._translation.close()
            self._translation = self._as_opened = None

    def _opened(self, session: Session, report: Report) -> Translation:
        request = request_of(session)
        if self._translation is not None and request == self._request:
            self._translation = self._translation.grown()
            return self._translation
        report.step(0.0, "opening the recording")
        translation = open_request(request, self._catalogue)
        if self._translation is not None:
            self._translation.close()
        self._translation = self._as_opened = translation
        self._drawing = Drawing(*self._drawn_bytes)
        self._forget_beside()
        self._opened_anew = True  # the window lets go of what it showed once it is told, so after the first frame
        self._request = request_of(replace(session, target=translation.target.name))
        self._begins_at = touched_frame(translation.stream) if session.frame < 0 else session.frame
        if session.frame < 0:
            report.hand_over(BeginsAt(index=self._begins_at))
        for note in translation.notes:
            log.info("%s", note)
        report.hand_over(translation)
        return translation


def _weight(values: Mapping[str, object]) -> int:
    return sum(size_bytes(value) for value in values.values())
