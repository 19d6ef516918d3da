"""One frame's touch by every method that can make it, each judged by what the target really recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.base.errors import TouchError
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, Method, StageResult
from pipeline.evaluation.recorded_touch import (
    RecordedTouch,
    build_recorded_touch,
    build_without_truth,
    compute_generated_change,
)
from pipeline.evaluation.touch_metrics import compute_touch_metrics, pool_metrics
from pipeline.networks.weights import NoWeights
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap, GeneratedTouch

STAGE = "touch"
_CACHE_BYTES = 64 * 1024 * 1024  # a dozen frames by every method
_MOST_TIMES = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodResult:
    """A frame's touch by one method; NaN where nothing is known to judge it by."""

    method: Method
    touch: GeneratedTouch | None  # None = there is no answer, and `problem` says why
    error_mm: float = math.nan  # of the membrane, over the whole picture
    contact_error_mm: float = math.nan  # the same where the target really is touched
    psnr_db: float = math.nan
    ssim: float = math.nan
    ms: float = math.nan  # of all slots up to the touch
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AvailableMethods:
    """Those methods that can make the touch, each with a translation by it, and sentences about those that cannot."""

    translations: tuple[tuple[Method, Translation], ...]
    excluded: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodCache:
    """What methods share of a frame, and how long each slot took when it was worked out."""

    graph: Graph = field(default_factory=lambda: Graph((), cache=Cache(_CACHE_BYTES)))
    times_ms: Memo[tuple[str, str], float] = field(default_factory=lambda: Memo(_MOST_TIMES))
    loaded_methods: set[str] = field(
        default_factory=set[str]
    )  # methods by network whose libraries and weights are loaded

    def clear(self) -> None:
        """Forget what was worked out, and of networks that they were loaded; times are known on."""
        self.graph.cache.clear()
        self.loaded_methods.clear()


def list_available_methods(translation: Translation) -> AvailableMethods:
    """Every method of the slot *touch* in the catalogue's order; a learned one needs weights of this direction.

    A file of weights that the translation names is tried first. Raises SettingProblem where there is no such slot.
    """
    request = translation.request
    given = dict(request.weights)
    ways: list[tuple[Method, Translation]] = []
    absent: list[str] = []
    for method in translation.catalogue.stage(STAGE).methods:
        weights = given
        if method.weights is not None:
            found = method.weights(translation.source, translation.target, given.get(STAGE))
            if isinstance(found, NoWeights) and STAGE in given:
                weights = {slot: file for slot, file in given.items() if slot != STAGE}
                found = method.weights(translation.source, translation.target, None)
            if isinstance(found, NoWeights):
                absent.append(f"{method.title}: {found.why.partition(';')[0]}")
                continue
        chosen = tuple({**dict(request.methods), STAGE: method.name}.items())
        asked = replace(request, methods=chosen, weights=tuple(weights.items()))
        ways.append((method, replace(translation, request=asked)))
    return AvailableMethods(translations=tuple(ways), excluded=tuple(absent))


def evaluate_methods(
    translation: Translation, frame: int, params: Mapping[str, object], kept: MethodCache, progress: Progress = SILENT
) -> Iterator[MethodResult]:
    """The frame's touch by each way, in the catalogue's order; `params` are those of methods by key.

    A method that cannot answer this frame has its sentence; Cancelled is raised when `progress` says so.
    """
    ways = list_available_methods(translation).translations
    true = _truth(translation, frame)
    for index, (method, way) in enumerate(ways):
        part = SubProgress(progress, index / len(ways), 1.0 / len(ways), method.title)
        part.step(0.0, "")
        try:
            yield _version(method, way, frame, params, kept, true, part)
        except TouchError as problem:
            yield MethodResult(method=method, touch=None, problem=str(problem))


def _version(
    method: Method, way: Translation, frame: int, params: Mapping[str, object], kept: MethodCache, true: RecordedTouch | None,
    progress: Progress,
) -> MethodResult:  # fmt: skip
    graph = way.build_graph(like=kept.graph)
    inputs = way.read_inputs(frame)
    told = {m.stage: params[m.key] for m in way.methods if m.key in params}
    results = graph.evaluate([STAGE], inputs, told, progress)
    made = results[STAGE]
    touch = made.output
    assert isinstance(touch, GeneratedTouch)
    if (
        method.weights is not None
        and method.key not in kept.loaded_methods
        and made.state == "computed"
        and not made.fallback
    ):
        kept.loaded_methods.add(method.key)  # the first answer of a process counts loading, which no other does
        above = {name: result.output for name, result in results.items() if name != STAGE}
        again = Graph(way.methods).evaluate([STAGE], {**inputs, **above}, told, progress)[STAGE]
        results = {**results, STAGE: replace(made, ms=again.ms)}
    ms = _ms(results, kept)
    if made.fallback:
        return MethodResult(method=method, touch=touch, ms=ms, problem=made.fallback)
    version = MethodResult(method=method, touch=touch, ms=ms)
    return version if true is None else _judged(version, _felt(touch, graph, inputs, told, progress), true, way)


def _ms(results: Mapping[str, StageResult], kept: MethodCache) -> float:
    """As if every slot had been worked out for this method alone."""
    total = 0.0
    for result in results.values():
        key = ("" if result.method is None else result.method.key, result.digest)
        known = kept.times_ms.get(key)
        if known is None or result.state == "computed":
            kept.times_ms.put(key, result.ms)
            known = result.ms
        total += known
    return total


def _felt(
    touch: GeneratedTouch, graph: Graph, inputs: Mapping[str, object], params: Mapping[str, object], progress: Progress
) -> DepthMap | None:
    """Its own membrane; of a gel's picture without one what that is read as, None where the route cannot."""
    if touch.membrane is not None or touch.image.ndim == 2:
        return touch.membrane
    if "touch_depth" not in {method.stage for method in graph.methods}:
        return None
    felt = graph.evaluate(["touch_depth"], inputs, params, progress)["touch_depth"].output
    return felt if isinstance(felt, DepthMap) else None


def _judged(version: MethodResult, touch_depth: DepthMap | None, true: RecordedTouch, way: Translation) -> MethodResult:
    assert version.touch is not None
    everywhere = np.ones(true.contact.shape, np.bool_)
    found = pool_metrics(
        [
            compute_touch_metrics(
                compute_generated_change(version.touch, way.target), touch_depth, true, everywhere, None
            )
        ]
    )

    def of(name: str, region: str = "all") -> float:
        return found.get(name, {}).get(region, math.nan)

    return replace(
        version, error_mm=of("error_mm"), contact_error_mm=of("error_mm", "contact"), psnr_db=of("psnr_db"),
        ssim=of("ssim"),
    )  # fmt: skip


def _truth(translation: Translation, frame: int) -> RecordedTouch | None:
    """What the target recorded of the frame, at its described size; None where it took no part."""
    other = translation.read_target_observation(frame)
    if other is None or other[0].reference is None or other[0].image.shape[:2] != translation.target.camera.shape:
        return None
    known = other[1] is not None and other[1].indentation_mm is not None and other[1].contact is not None
    return build_recorded_touch(*other) if known else build_without_truth(other[0])
