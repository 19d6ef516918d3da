"""A live sensor through the stages on all cores: results in order, the newest frame first, none
invented.

A frame that a newer one has overtaken before a worker was idle is left out, and so is a result that
comes after a newer one's. Each pose starts at the last one that came.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from concurrent.futures import BrokenExecutor, Future, wait
from dataclasses import dataclass
from statistics import median

from pipeline.core.errors import TouchError
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import ObjectPose
from pipeline.io.live.reader import LiveReader
from pipeline.translation.frame_workers import FrameWorkers, Results
from pipeline.translation.live_rate import FrameCost, RatePlan, plan_rate
from pipeline.translation.translate import Translation

_POSE = "pose"
_MEASURED_FRAMES = 30  # with contact, whose times the plan follows
_EARLY_SHARE = 0.8  # of a period of the rate after which the next frame is due: sources jitter
_POLL_S = 0.005  # between looks for a newer frame while the workers are idle
_MAX_GAP_S = 0.5  # after which a pose is searched anew


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveResult:
    """A translated frame of a live sensor."""

    frame: TactileFrame
    results: Results
    age_s: float  # of the frame when its results came
    plan: RatePlan  # by which they were computed


@dataclass(frozen=True, slots=True, kw_only=True)
class _Offered:
    frame: TactileFrame
    answer: Future[Results]
    plan: RatePlan


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
        """Start nothing yet: `translation` is of the reader's recording, a rate of 0 is best
        quality, and 0 workers are one a core.
        """
        self.plan = RatePlan(rate_hz=rate_hz)
        self.problem = ""  # of the last frame that could not be translated
        self._stages = translation.stages
        self._reader = reader
        self._workers = FrameWorkers(translation, n_workers)
        self._offered: deque[_Offered] = deque()
        self._last_offered: TactileFrame | None = None
        self._last_shown = -1
        self._n_offered = 0
        self._pose: tuple[float, ObjectPose] | None = None  # the last one, and its frame's time
        self._times_ms: dict[str, deque[float]] = {
            name: deque(maxlen=_MEASURED_FRAMES) for name in ("stages", "draft", _POSE)
        }

    def poll(self, timeout_s: float = 0.0) -> list[LiveResult]:
        """Return the results that have come, after at most `timeout_s` if there are none, and give
        idle workers the newest frame.

        Raises NotConverged where a worker has died, and whatever nobody foresaw; a frame that
        cannot be translated is the `problem` until the next one.
        """
        self._offer_newest()
        if self._offered:
            wait([one.answer for one in self._offered], timeout_s, "FIRST_COMPLETED")
        else:
            time.sleep(min(timeout_s, _POLL_S))
        come = [one for one in self._offered if one.answer.done()]
        self._offered = deque(one for one in self._offered if not one.answer.done())
        self._offer_newest()
        return [result for one in come if (result := self._collect(one)) is not None]

    def _offer_newest(self) -> None:
        reader = self._reader
        newest = reader.n_frames - 1
        last = self._last_offered
        if newest < 0 or not reader.has_reference or not self._workers.has_room:
            return
        if last is not None and newest <= last.index:
            return
        frame = reader.frame(newest)
        rate_hz = self.plan.rate_hz
        if last is not None and rate_hz and (frame.time_s - last.time_s) * rate_hz < _EARLY_SHARE:
            return
        with_pose = self._n_offered % self.plan.pose_every == 0
        answer = self._workers.submit(
            frame,
            [name for name in self._stages if name != _POSE or with_pose],
            previous=self._get_previous(frame),
            draft=self.plan.draft,
        )
        self._offered.append(_Offered(frame=frame, answer=answer, plan=self.plan))
        self._last_offered = frame
        self._n_offered += 1

    def _get_previous(self, frame: TactileFrame) -> ObjectPose | None:
        if self._pose is None or frame.time_s - self._pose[0] > _MAX_GAP_S:
            return None
        return self._pose[1]

    def _collect(self, one: _Offered) -> LiveResult | None:
        """Return the result of a frame; None for one that is late or could not be translated."""
        try:
            results = one.answer.result()
        except TouchError as error:
            self.problem = str(error)
            return None
        except BrokenExecutor:
            return None  # the next frame that is offered says so
        self.problem = ""
        if one.frame.index < self._last_shown:
            return None
        self._last_shown = one.frame.index
        pose = results[_POSE].output if _POSE in results else None
        if isinstance(pose, ObjectPose):
            is_known = pose.sensor_from_object is not None
            self._pose = (one.frame.time_s, pose) if is_known else None
        self._measure(results, is_draft=one.plan.draft)
        age_s = self._reader.measure_age_s(one.frame)
        return LiveResult(frame=one.frame, results=results, age_s=age_s, plan=one.plan)

    def _measure(self, results: Results, *, is_draft: bool) -> None:
        """Add the times of a frame with contact, and plan what its successors leave out."""
        if any(result.state == "skipped" for result in results.values()):
            return
        stages_ms = sum(result.ms for name, result in results.items() if name != _POSE)
        self._times_ms["draft" if is_draft else "stages"].append(stages_ms)
        if _POSE in results:
            self._times_ms[_POSE].append(results[_POSE].ms)
        stages, draft, pose = (_get_median(times) for times in self._times_ms.values())
        cost = None
        if stages is not None:
            cost = FrameCost(stages_ms=stages, draft_ms=draft, pose_ms=pose or 0.0)
        self.plan = plan_rate(self.plan.rate_hz, cost, self._workers.n_workers)

    def close(self) -> None:
        """End the workers."""
        self._workers.close()


def _get_median(values: Iterable[float]) -> float | None:
    known = list(values)
    return median(known) if known else None
