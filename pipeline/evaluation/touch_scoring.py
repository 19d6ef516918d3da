"""One recording scored in one direction: a pure piece of work, so that any process anywhere can do it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline.base.arrays import Floats
from pipeline.base.params import list_settings
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, StageResult
from pipeline.evaluation import touch_features
from pipeline.evaluation.candidates import MEAN_TOUCH, NO_CONTACT, RECORDED, Candidate, compute_mean_change
from pipeline.evaluation.held_out import PressRecordings
from pipeline.evaluation.recorded_touch import RecordedTouch, build_recorded_touch, compute_generated_change
from pipeline.evaluation.touch_metrics import TouchMetrics, compute_touch_metrics
from pipeline.recordings import open_recording
from pipeline.stages.touch.physical_render import make_reference_touch
from pipeline.stages.touch.touch_from_change import make_touch_from_change
from pipeline.translation.catalogue import default_params, with_setting
from pipeline.translation.translate import Request, Translation, open_translation
from pipeline.values.results import DepthMap, GeneratedTouch, ObjectPose, TargetDepth

_CACHE_BYTES = 64 * 1024 * 1024  # one frame's slots by every contender


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoringJob:
    """What to score: all contenders on all touches of one recording, in one direction."""

    recordings: PressRecordings
    source: str
    target: str
    candidates: tuple[Candidate, ...]
    training_recordings: tuple[Path, ...] = ()  # recordings that the mean touch is taken of
    methods: Mapping[str, str] = field(default_factory=dict)  # slot -> method, other than touch's
    settings: tuple[str, ...] = ()  # slot.parameter=value
    pose_methods: tuple[str, ...] = ()  # methods of the slot pose that the touches are judged by


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredTouch:
    """One touch by one contender."""

    candidate: str
    touch_name: str  # recording and frame
    metrics: TouchMetrics
    ms: float  # of all slots up to the touch; 0 for one that is given
    pose_errors: Mapping[str, tuple[float, float]]  # method -> (mm, deg) in the target's plane; absent = no answer
    features: Floats | None  # what the encoder sees; None = there is none for this sensor
    notes: tuple[str, ...] = ()


def score_recording(job: ScoringJob, progress: Progress = SILENT) -> list[ScoredTouch]:
    """Every touch of the job by every contender, in the order of the recording."""
    translation = open_translation(Request(
        recording=job.recordings.source, target=job.target, source=job.source, methods=tuple(job.methods.items())
    ))  # fmt: skip
    with closing(translation), closing(open_recording(job.recordings.target)) as other:
        streams = translation.recording.stream(job.source), other.stream(job.target)
        both = replace(translation.recording, streams=streams)
        return list(_all(job, replace(translation, recording=both), progress))


def _all(job: ScoringJob, translation: Translation, progress: Progress) -> Iterator[ScoredTouch]:
    mean = compute_mean_change(job.training_recordings, job.target) if job.training_recordings else None
    for index in range(translation.n_frames):
        progress.step(
            index / translation.n_frames, f"{job.recordings.object_name} {index + 1} of {translation.n_frames}"
        )
        other = translation.read_target_observation(index)
        assert other is not None
        true = build_recorded_touch(*other)
        one = _Touch(job, translation, index, true, mean)
        for contender in job.candidates:
            yield one.score_candidate(contender)


class _Touch:
    """One recorded touch, which the contenders' results share what they can of."""

    def __init__(
        self, job: ScoringJob, translation: Translation, index: int, true: RecordedTouch, mean: Floats | None
    ) -> None:
        self._job, self._translation, self._index, self._true, self._mean = job, translation, index, true, mean
        self._cache = Graph((), cache=Cache(_CACHE_BYTES))
        self._ms: dict[str, float] = {}
        view = self._evaluated("physics", {}, "target_depth")["target_depth"].output
        assert isinstance(view, TargetDepth)
        self._known = view.in_view

    def score_candidate(self, contender: Candidate) -> ScoredTouch:
        given = self._given(contender)
        results = {} if given else self._evaluated(contender.name, {}, "touch")
        touch = given.get("touch") or results["touch"].output
        assert isinstance(touch, GeneratedTouch)
        made = compute_generated_change(touch, self._translation.target)
        felt = given.get("touch_depth") or self._felt(touch)
        assert felt is None or isinstance(felt, DepthMap)
        mean = self._mean if contender.name not in (MEAN_TOUCH, NO_CONTACT, RECORDED) else None
        figures = compute_touch_metrics(made, felt, self._true, self._known, mean)
        if contender.name == RECORDED:
            figures = replace(figures, values={})
        return ScoredTouch(
            candidate=contender.name,
            touch_name=f"{self._job.recordings.object_name} {self._index}",
            metrics=figures,
            ms=sum(self._ms[result.method.key] for result in results.values() if result.method is not None),
            pose_errors=self._poses(contender, {**given, "touch": touch, "touch_depth": felt}),
            features=touch_features.encode_change(self._translation.target, made),
            notes=tuple(dict.fromkeys(result.fallback for result in results.values() if result.fallback)),
        )

    def _evaluated(self, touch: str, given: Mapping[str, object], stage: str, pose: str = "") -> dict[str, StageResult]:
        """Results up to a slot with one method of touch and pose; times are kept where something was worked out."""
        chosen = {**self._job.methods, "touch": touch} | ({"pose": pose} if pose else {})
        like = replace(self._translation, request=replace(self._translation.request, methods=tuple(chosen.items())))
        graph, params = like.build_graph(like=self._cache), default_params(like.methods)
        for assignment in self._job.settings:
            if _is_for(assignment, params):
                params = with_setting(params, assignment)
        results = graph.evaluate([stage], {**like.read_inputs(self._index), **given}, params)
        for result in results.values():
            if result.method is not None and result.state in ("computed", "skipped"):
                self._ms.setdefault(result.method.key, result.ms)
        return results

    def _given(self, contender: Candidate) -> dict[str, object]:
        """What stands in place of the slots for those that need no source."""
        target = self._translation.target
        if contender.name == NO_CONTACT:
            return {"touch": make_reference_touch(target)}
        if contender.name == MEAN_TOUCH:
            return (
                {"touch": make_touch_from_change(target, self._mean)}
                if self._mean is not None
                else {"touch": make_reference_touch(target)}
            )
        if contender.name == RECORDED:
            read = self._translation.with_target_as_source()
            read = replace(read, request=replace(read.request, methods=tuple(self._job.methods.items())))
            inputs = read.read_inputs(self._index)
            depth = read.build_graph(like=self._cache).evaluate(["depth"], inputs, default_params(read.methods))[
                "depth"
            ]
            return {"touch": make_touch_from_change(target, self._true.change), "touch_depth": depth.output}
        return {}

    def _felt(self, touch: GeneratedTouch) -> DepthMap | None:
        """Its own membrane where it has one, else its picture read as a recording of the target."""
        how = "reading" if touch.membrane is None else "membrane"
        chosen = replace(self._translation, request=replace(
            self._translation.request, methods=(*self._job.methods.items(), ("touch_depth", how))
        ))  # fmt: skip
        inputs = {"touch": touch, "target": chosen.target}
        felt = chosen.build_graph(like=self._cache).evaluate(["touch_depth"], inputs, {})["touch_depth"].output
        assert isinstance(felt, DepthMap)
        return felt

    def _poses(self, contender: Candidate, given: Mapping[str, object]) -> dict[str, tuple[float, float]]:
        """(mm, deg) in the target's plane by every method; one that has no answer is absent."""
        found: dict[str, tuple[float, float]] = {}
        facts = self._translation.read_ground_truth(self._index)
        slot = self._translation.catalogue.stage("pose")
        for name in self._job.pose_methods:
            if contender.name == NO_CONTACT:
                continue
            pose = self._evaluated("physics", given, "pose", name)["pose"].output
            assert isinstance(pose, ObjectPose)
            errors = slot.compute_metrics(pose, facts)
            if "se2_mm" in errors and "se2_deg" in errors:
                found[name] = errors["se2_mm"], errors["se2_deg"]
        return found


def _is_for(assignment: str, params: Mapping[str, object]) -> bool:
    """Whether a setting is for these methods: those of the touch differ in what they have to set."""
    slot, _, name = assignment.partition("=")[0].strip().partition(".")
    return slot != "touch" or name in list_settings(params[slot])
