"""One recording scored in one direction: a pure piece of work, so that any process anywhere can do it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline.base.arrays import Floats
from pipeline.base.params import settings
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, StageResult
from pipeline.recordings import open_recording
from pipeline.scoring import features
from pipeline.scoring.compared import Recorded, generated, recorded
from pipeline.scoring.contenders import MEAN, RECORDED, UNTOUCHED, Contender, mean_change
from pipeline.scoring.figures import TouchFigures, touch_figures
from pipeline.scoring.held_out import Presses
from pipeline.stages.generate.pictured import touch_of
from pipeline.stages.generate.stage import at_rest
from pipeline.translation.catalogue import default_params, with_setting
from pipeline.translation.translate import Request, Translation, open_translation
from pipeline.values.results import DepthMap, ObjectPose, TargetView, Touch

_CACHE_BYTES = 64 * 1024 * 1024  # one frame's slots by every contender


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What to score: all contenders on all touches of one recording, in one direction."""

    presses: Presses
    source: str
    target: str
    contenders: tuple[Contender, ...]
    usual: tuple[Path, ...] = ()  # recordings that the mean touch is taken of
    methods: Mapping[str, str] = field(default_factory=dict)  # slot -> method, other than touch's
    settings: tuple[str, ...] = ()  # slot.parameter=value
    poses: tuple[str, ...] = ()  # methods of the slot pose that the touches are judged by


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """One touch by one contender."""

    contender: str
    touch: str  # recording and frame
    figures: TouchFigures
    ms: float  # of all slots up to the touch; 0 for one that is given
    poses: Mapping[str, tuple[float, float]]  # method -> (mm, deg) in the target's plane; absent = no answer
    features: Floats | None  # what the encoder sees; None = there is none for this sensor
    notes: tuple[str, ...] = ()


def scored(job: Job, progress: Progress = SILENT) -> list[Scored]:
    """Every touch of the job by every contender, in the order of the recording."""
    translation = open_translation(Request(
        recording=job.presses.source, target=job.target, source=job.source, methods=tuple(job.methods.items())
    ))  # fmt: skip
    with closing(translation), closing(open_recording(job.presses.target)) as other:
        streams = translation.recording.stream(job.source), other.stream(job.target)
        both = replace(translation.recording, streams=streams)
        return list(_all(job, replace(translation, recording=both), progress))


def _all(job: Job, translation: Translation, progress: Progress) -> Iterator[Scored]:
    mean = mean_change(job.usual, job.target) if job.usual else None
    for index in range(translation.n_frames):
        progress.step(index / translation.n_frames, f"{job.presses.thing} {index + 1} of {translation.n_frames}")
        other = translation.truth_of_target(index)
        assert other is not None
        true = recorded(*other)
        one = _Touch(job, translation, index, true, mean)
        for contender in job.contenders:
            yield one.scored(contender)


class _Touch:
    """One recorded touch, which the contenders' results share what they can of."""

    def __init__(self, job: Job, translation: Translation, index: int, true: Recorded, mean: Floats | None) -> None:
        self._job, self._translation, self._index, self._true, self._mean = job, translation, index, true, mean
        self._cache = Graph((), cache=Cache(_CACHE_BYTES))
        self._ms: dict[str, float] = {}
        view = self._evaluated("physics", {}, "view")["view"].output
        assert isinstance(view, TargetView)
        self._known = view.known

    def scored(self, contender: Contender) -> Scored:
        given = self._given(contender)
        results = {} if given else self._evaluated(contender.name, {}, "touch")
        touch = given.get("touch") or results["touch"].output
        assert isinstance(touch, Touch)
        made = generated(touch, self._translation.target)
        felt = given.get("felt") or self._felt(touch)
        assert felt is None or isinstance(felt, DepthMap)
        mean = self._mean if contender.name not in (MEAN, UNTOUCHED, RECORDED) else None
        figures = touch_figures(made, felt, self._true, self._known, mean)
        if contender.name == RECORDED:
            figures = replace(figures, values={})
        return Scored(
            contender=contender.name,
            touch=f"{self._job.presses.thing} {self._index}",
            figures=figures,
            ms=sum(self._ms[result.method.key] for result in results.values() if result.method is not None),
            poses=self._poses(contender, {**given, "touch": touch, "felt": felt}),
            features=features.of(self._translation.target, made),
            notes=tuple(dict.fromkeys(result.instead for result in results.values() if result.instead)),
        )

    def _evaluated(self, touch: str, given: Mapping[str, object], slot: str, pose: str = "") -> dict[str, StageResult]:
        """Results up to a slot with one method of touch and pose; times are kept where something was worked out."""
        chosen = {**self._job.methods, "touch": touch} | ({"pose": pose} if pose else {})
        like = replace(self._translation, request=replace(self._translation.request, methods=tuple(chosen.items())))
        graph, params = like.graph(like=self._cache), default_params(like.methods)
        for assignment in self._job.settings:
            if _is_for(assignment, params):
                params = with_setting(params, assignment)
        results = graph.evaluate([slot], {**like.inputs(self._index), **given}, params)
        for result in results.values():
            if result.method is not None and result.state in ("computed", "skipped"):
                self._ms.setdefault(result.method.key, result.ms)
        return results

    def _given(self, contender: Contender) -> dict[str, object]:
        """What stands in place of the slots for those that need no source."""
        target = self._translation.target
        if contender.name == UNTOUCHED:
            return {"touch": at_rest(target)}
        if contender.name == MEAN:
            return {"touch": touch_of(target, self._mean)} if self._mean is not None else {"touch": at_rest(target)}
        if contender.name == RECORDED:
            read = self._translation.of_target()
            read = replace(read, request=replace(read.request, methods=tuple(self._job.methods.items())))
            inputs = read.inputs(self._index)
            depth = read.graph(like=self._cache).evaluate(["depth"], inputs, default_params(read.methods))["depth"]
            return {"touch": touch_of(target, self._true.change), "felt": depth.output}
        return {}

    def _felt(self, touch: Touch) -> DepthMap | None:
        """Its own membrane where it has one, else its picture read as a recording of the target."""
        how = "reading" if touch.membrane is None else "membrane"
        chosen = replace(self._translation, request=replace(
            self._translation.request, methods=(*self._job.methods.items(), ("felt", how))
        ))  # fmt: skip
        inputs = {"touch": touch, "target": chosen.target}
        felt = chosen.graph(like=self._cache).evaluate(["felt"], inputs, {})["felt"].output
        assert isinstance(felt, DepthMap)
        return felt

    def _poses(self, contender: Contender, given: Mapping[str, object]) -> dict[str, tuple[float, float]]:
        """(mm, deg) in the target's plane by every method; one that has no answer is absent."""
        found: dict[str, tuple[float, float]] = {}
        facts = self._translation.facts(self._index)
        slot = self._translation.catalogue.slot("pose")
        for name in self._job.poses:
            if contender.name == UNTOUCHED:
                continue
            pose = self._evaluated("physics", given, "pose", name)["pose"].output
            assert isinstance(pose, ObjectPose)
            errors = slot.figures(pose, facts)
            if "se2_mm" in errors and "se2_deg" in errors:
                found[name] = errors["se2_mm"], errors["se2_deg"]
        return found


def _is_for(assignment: str, params: Mapping[str, object]) -> bool:
    """Whether a setting is for these methods: those of the touch differ in what they have to set."""
    slot, _, name = assignment.partition("=")[0].strip().partition(".")
    return slot != "touch" or name in settings(params[slot])
