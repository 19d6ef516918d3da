"""A live sensor through the stages on all cores: results in order, the newest frame first, none
invented.

A frame that a newer one has overtaken before a worker was idle is left out, and so is a result that
comes long after a newer one's. Pose and membrane start at the last ones that came; the light of a
gel is that of the touches so far, as a recording's is that of all.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Generator, Mapping
from concurrent.futures import BrokenExecutor, Future, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import TouchError
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import Stream, TactileFrame
from pipeline.io.live.paired_reader import make_reader
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.source import LiveSource, LiveSourceLost
from pipeline.io.mounts import mount, unmount
from pipeline.sensors.spec import load_sensor
from pipeline.stages.stage import GroundTruth
from pipeline.translation.following import FROM_REST, get_start, is_close
from pipeline.translation.frame_selection import select_context_frames
from pipeline.translation.frame_workers import FrameWorkers, Results, Shared
from pipeline.translation.live_rate import RatePlan, RateRule, pop_in_order
from pipeline.translation.translate import Request, Translation, open_translation

LIVE = Path("live:/1")  # a name by which a sensor opens like a file
_POSE = "pose"
_POLL_S = 0.005  # between looks for a newer frame while a worker is idle
_WAIT_S = 1.0  # for results, and for the reader's thread to end
_PATIENCE_S = 10.0  # with a problem and no result
# that a frame has waited for a worker to start, or its results for whoever takes them
_STALE_S = 0.5
_KEPT_TOUCHES = 24  # from which those are chosen that determine the light


@frozen
class LiveResult:
    """A translated frame of a live sensor."""

    frame: TactileFrame  # with the context images by which it was translated
    results: Results
    age_s: float  # of the frame when its results came
    plan: RatePlan  # by which they were computed
    truth: GroundTruth  # what the target's own sensor took of it, and a simulated one's truth
    translation: Translation

    @property
    def metrics(self) -> Mapping[str, float]:
        """`stage.metric` -> error against the truth, in the unit that the name ends in.

        {} without any truth.
        """
        return self.translation.compute_metrics_against(self.results, self.truth)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Context:
    """Touches that determine the light, as the workers share them."""

    reference: Image | Floats | None
    images: tuple[Image, ...]
    shared: Shared


@frozen
class _Offered:
    frame: TactileFrame
    answer: Future[Results]
    plan: RatePlan
    context: _Context | None
    truth: GroundTruth
    offered_s: float  # by the monotonic clock


class LiveTranslation:
    """Translates the newest frames of a reader while `poll` is called; used by one thread."""

    def __init__(
        self,
        translation: Translation,
        reader: LiveReader,
        *,
        rate_hz: float = 0.0,
        n_workers: int = 0,
    ) -> None:
        """Start the workers: `translation` is of the reader's recording, a rate of 0 is best
        quality, and 0 workers are one a core.
        """
        self.problem = ""  # of the last frame that could not be translated
        self._translation = translation
        self._stages = translation.stages
        self._reader = reader
        self._workers = FrameWorkers(translation, n_workers)
        self._workers.warm_up()
        self._rule = RateRule(
            rate_hz=rate_hz,
            n_workers=self._workers.n_workers,
            has_draft=self._workers.has_draft,
        )
        self._offered: deque[_Offered] = deque()
        self._newest_seen = -1
        self._n_offered = 0
        self._n_stale = 0  # results in a row that were left out for their age
        # where the next frame starts, and of when its pose and its membrane are
        self._start = FROM_REST
        self._pose_time_s = self._touch_time_s = math.nan
        # a calibration table contains the light, and a depth camera needs none
        self._fits_light = translation.source.optics is not None and translation.calibration is None
        self._touches: list[TactileFrame] = []
        self._n_touches = 0
        self._stride = 1  # every n-th touch is kept
        self._context: _Context | None = None
        # to whose touches one worker fits the light, while others go on with the last one
        self._new_context: _Context | None = None

    @property
    def plan(self) -> RatePlan:
        """What is left out of the next frames."""
        return self._rule.plan

    def poll(self, timeout_s: float = 0.0) -> list[LiveResult]:
        """Return the results that have come, after at most `timeout_s` if there are none, and give
        idle workers the newest frame.

        Raises NotConverged where a worker has died, and whatever nobody foresaw; a frame that
        cannot be translated is the `problem` until the next one.
        """
        ends_s = time.monotonic() + timeout_s
        while True:
            self._offer_newest()
            done = pop_in_order(
                self._offered, lambda one: one.answer.done(), self._workers.n_workers - 1
            )
            left_s = max(ends_s - time.monotonic(), 0.0)
            if done or not left_s:
                return [result for one in done if (result := self._collect(one)) is not None]
            waited = [one.answer for one in self._offered if not one.answer.done()]
            rest_s = min(left_s, _POLL_S) if self._workers.has_room else left_s
            if waited:
                wait(waited, rest_s, "FIRST_COMPLETED")
            else:
                time.sleep(rest_s)

    def _offer_newest(self) -> None:
        reader = self._reader
        newest = reader.n_frames - 1
        if newest <= self._newest_seen or not reader.has_reference or not self._workers.has_room:
            return
        frame = reader.frame(newest)
        self._newest_seen = newest
        if not self._rule.take(frame.time_s):
            return
        plan = self.plan
        with_pose = self._n_offered % plan.pose_every == 0
        context = self._select_context(frame)
        start = self._start
        if not is_close(self._pose_time_s, frame.time_s):
            start = replace(start, pose=None)
        if not is_close(self._touch_time_s, frame.time_s):
            start = replace(start, membrane=None)
        answer = self._workers.submit(
            frame,
            [name for name in self._stages if name != _POSE or with_pose],
            start=start,
            context=None if context is None else context.shared,
            draft=plan.draft,
        )
        truth = self._translation.reload_frames().read_ground_truth(newest)
        self._offered.append(
            _Offered(
                frame=frame,
                answer=answer,
                plan=plan,
                context=context,
                truth=truth,
                offered_s=time.monotonic(),
            )
        )
        self._n_offered += 1

    def _select_context(self, frame: TactileFrame) -> _Context | None:
        new = self._new_context
        is_tried = any(one.context is new for one in self._offered)
        for context in (self._context if is_tried else new, self._context):
            if context is not None and context.reference is frame.reference:
                return context
        return None

    def _collect(self, one: _Offered) -> LiveResult | None:
        """Return the result of a frame; None for one that could not be translated."""
        context = one.context
        if context is not None and context is self._new_context:
            self._context, self._new_context = context, None
        try:
            results = one.answer.result()
        except TouchError as error:
            self.problem = str(error)
            return None
        except BrokenExecutor:
            return None  # the next frame that is offered says so
        self.problem = ""
        start = get_start(results)
        self._touch_time_s = one.frame.time_s
        if _POSE in results:
            self._pose_time_s = one.frame.time_s
        else:
            start = replace(start, pose=self._start.pose)
        self._start = start
        stages = [result for name, result in results.items() if name != _POSE]
        if not any(result.state == "skipped" for result in stages):
            pose_ms = results[_POSE].ms if _POSE in results else None
            stages_ms = sum(result.ms for result in stages)
            self._rule.add_cost(one.plan, one.frame.time_s, stages_ms, pose_ms)
            self._keep_touch(one.frame)
        if self._is_stale(one, results):
            return None
        frame = one.frame if context is None else replace(one.frame, context_frames=context.images)
        return LiveResult(
            frame=frame,
            results=results,
            age_s=self._reader.measure_age_s(frame),
            plan=one.plan,
            truth=one.truth,
            translation=self._translation,
        )

    def _is_stale(self, one: _Offered, results: Results) -> bool:
        """Whether a newer frame should be shown: one that came while nothing took this one.

        What takes long to compute is shown at any age; as many in a row may be stale as were under
        way.
        """
        computed_s = 1e-3 * sum(result.ms for result in results.values())
        waited_s = time.monotonic() - one.offered_s - computed_s
        is_stale = (
            waited_s > _STALE_S
            and self._reader.n_frames - 1 > one.frame.index
            and self._n_stale < self._workers.n_workers
        )
        self._n_stale = self._n_stale + 1 if is_stale else 0
        return is_stale

    def _keep_touch(self, frame: TactileFrame) -> None:
        """Keep touches spread over the time so far, and choose those that determine the light each
        time that there are twice as many.
        """
        if not self._fits_light:
            return
        if self._touches and self._touches[0].reference is not frame.reference:
            self._touches, self._stride = [], 1
        self._n_touches += 1
        if self._n_touches % self._stride:
            return
        self._touches.append(frame)
        if len(self._touches) < _KEPT_TOUCHES:
            return
        chosen = select_context_frames(
            Stream(
                name=frame.sensor,
                sensor=frame.sensor,
                n_frames=len(self._touches),
                frame=self._touches.__getitem__,
                truth=lambda _: None,
            )
        )
        images = tuple(cast("Image", one.image) for one in chosen)
        self._new_context = _Context(
            reference=frame.reference, images=images, shared=self._workers.share(images)
        )
        del self._touches[::2]
        self._stride *= 2

    def close(self) -> None:
        """End the workers."""
        self._workers.close()


def translate_live(
    source: LiveSource,
    request: Request,
    rate_hz: float = 0.0,
    partner: LiveSource | None = None,
) -> Generator[LiveResult]:
    """Yield what a sensor shows, translated, until the generator is closed.

    The request's recording is a name by which the sensor opens meanwhile, like a file. Raises
    LiveSourceLost where a sensor is not there, or no frame can be translated, for a while.
    """
    load_sensor(request.target)  # a wrong name is said before anything starts
    reader = make_reader(source, partner)
    live: LiveTranslation | None = None
    mount(request.recording, lambda: reader.make_recording(request.recording))
    try:
        reader.start()
        came_s = time.monotonic()
        while True:
            if live is None and reader.has_reference:
                live = LiveTranslation(open_translation(request), reader, rate_hz=rate_hz)
            if live is None:
                time.sleep(_POLL_S)
            for result in [] if live is None else live.poll(_WAIT_S):
                given_s = time.monotonic()
                yield result
                came_s = time.monotonic()
                if came_s - given_s > _STALE_S:
                    break  # the others are older than what comes next
            status = reader.status()
            problem = "" if live is None else live.problem
            if live is None or status.state != "running":
                problem = status.message
            if not problem:
                came_s = time.monotonic()
            elif time.monotonic() - came_s > _PATIENCE_S:
                why = problem.removesuffix("; trying again")
                raise LiveSourceLost(f"{reader.title}: nothing for {_PATIENCE_S:g} s: {why}")
    finally:
        unmount(request.recording)
        if live is not None:
            live.close()
        reader.stop(_WAIT_S)
