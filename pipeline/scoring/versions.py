"""One frame's touch by every method that can make it, each judged by what the target really recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.base.errors import TouchError
from pipeline.base.memo import Memo
from pipeline.base.progress import SILENT, Progress, Share
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, Method, StageResult
from pipeline.networks.weights import NoWeights
from pipeline.scoring.compared import Recorded, generated, recorded, recorded_only
from pipeline.scoring.figures import pooled, touch_figures
from pipeline.translation.translate import Translation
from pipeline.values.results import DepthMap, Touch

SLOT = "touch"
_CACHE_BYTES = 64 * 1024 * 1024  # a dozen frames by every method
_MOST_TIMES = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class Version:
    """A frame's touch by one method; NaN where nothing is known to judge it by."""

    method: Method
    touch: Touch | None  # None = there is no answer, and `problem` says why
    error_mm: float = math.nan  # of the membrane, over the whole picture
    contact_error_mm: float = math.nan  # the same where the target really is touched
    psnr_db: float = math.nan
    ssim: float = math.nan
    ms: float = math.nan  # of all slots up to the touch
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Able:
    """Those methods that can make the touch, each with a translation by it, and sentences about those that cannot."""

    ways: tuple[tuple[Method, Translation], ...]
    absent: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """What methods share of a frame, and how long each slot took when it was worked out."""

    graph: Graph = field(default_factory=lambda: Graph((), cache=Cache(_CACHE_BYTES)))
    ms: Memo[tuple[str, str], float] = field(default_factory=lambda: Memo(_MOST_TIMES))
    warm: set[str] = field(default_factory=set[str])  # methods by network whose libraries and weights are loaded

    def let_go(self) -> None:
        """Forget what was worked out, and of networks that they were loaded; times are known on."""
        self.graph.cache.clear()
        self.warm.clear()


def able(translation: Translation) -> Able:
    """Every method of the slot *touch* in the catalogue's order; a learned one needs weights of this direction.

    A file of weights that the translation names is tried first. Raises SettingProblem where there is no such slot.
    """
    request = translation.request
    given = dict(request.weights)
    ways: list[tuple[Method, Translation]] = []
    absent: list[str] = []
    for method in translation.catalogue.slot(SLOT).methods:
        weights = given
        if method.weights is not None:
            found = method.weights(translation.source, translation.target, given.get(SLOT))
            if isinstance(found, NoWeights) and SLOT in given:
                weights = {slot: file for slot, file in given.items() if slot != SLOT}
                found = method.weights(translation.source, translation.target, None)
            if isinstance(found, NoWeights):
                absent.append(f"{method.title}: {found.why.partition(';')[0]}")
                continue
        chosen = tuple({**dict(request.methods), SLOT: method.name}.items())
        asked = replace(request, methods=chosen, weights=tuple(weights.items()))
        ways.append((method, replace(translation, request=asked)))
    return Able(ways=tuple(ways), absent=tuple(absent))


def versions(
    translation: Translation, frame: int, params: Mapping[str, object], kept: Kept, progress: Progress = SILENT
) -> Iterator[Version]:
    """The frame's touch by each way, in the catalogue's order; `params` are those of methods by key.

    A method that cannot answer this frame has its sentence; Cancelled is raised when `progress` says so.
    """
    ways = able(translation).ways
    true = _truth(translation, frame)
    for index, (method, way) in enumerate(ways):
        part = Share(progress, index / len(ways), 1.0 / len(ways), method.title)
        part.step(0.0, "")
        try:
            yield _version(method, way, frame, params, kept, true, part)
        except TouchError as problem:
            yield Version(method=method, touch=None, problem=str(problem))


def _version(
    method: Method, way: Translation, frame: int, params: Mapping[str, object], kept: Kept, true: Recorded | None,
    progress: Progress,
) -> Version:  # fmt: skip
    graph = way.graph(like=kept.graph)
    inputs = way.inputs(frame)
    told = {m.slot: params[m.key] for m in way.methods if m.key in params}
    results = graph.evaluate([SLOT], inputs, told, progress)
    made = results[SLOT]
    touch = made.output
    assert isinstance(touch, Touch)
    if method.weights is not None and method.key not in kept.warm and made.state == "computed" and not made.instead:
        kept.warm.add(method.key)  # the first answer of a process counts loading, which no other does
        above = {name: result.output for name, result in results.items() if name != SLOT}
        again = Graph(way.methods).evaluate([SLOT], {**inputs, **above}, told, progress)[SLOT]
        results = {**results, SLOT: replace(made, ms=again.ms)}
    ms = _ms(results, kept)
    if made.instead:
        return Version(method=method, touch=touch, ms=ms, problem=made.instead)
    version = Version(method=method, touch=touch, ms=ms)
    return version if true is None else _judged(version, _felt(touch, graph, inputs, told, progress), true, way)


def _ms(results: Mapping[str, StageResult], kept: Kept) -> float:
    """As if every slot had been worked out for this method alone."""
    total = 0.0
    for result in results.values():
        key = ("" if result.method is None else result.method.key, result.digest)
        known = kept.ms.get(key)
        if known is None or result.state == "computed":
            kept.ms.put(key, result.ms)
            known = result.ms
        total += known
    return total


def _felt(
    touch: Touch, graph: Graph, inputs: Mapping[str, object], params: Mapping[str, object], progress: Progress
) -> DepthMap | None:
    """Its own membrane; of a gel's picture without one what that is read as, None where the route cannot."""
    if touch.membrane is not None or touch.image.ndim == 2:
        return touch.membrane
    if "felt" not in {method.slot for method in graph.methods}:
        return None
    felt = graph.evaluate(["felt"], inputs, params, progress)["felt"].output
    return felt if isinstance(felt, DepthMap) else None


def _judged(version: Version, felt: DepthMap | None, true: Recorded, way: Translation) -> Version:
    assert version.touch is not None
    everywhere = np.ones(true.contact.shape, np.bool_)
    found = pooled([touch_figures(generated(version.touch, way.target), felt, true, everywhere, None)])

    def of(name: str, region: str = "all") -> float:
        return found.get(name, {}).get(region, math.nan)

    return replace(
        version, error_mm=of("error_mm"), contact_error_mm=of("error_mm", "contact"), psnr_db=of("psnr_db"),
        ssim=of("ssim"),
    )  # fmt: skip


def _truth(translation: Translation, frame: int) -> Recorded | None:
    """What the target recorded of the frame, at its described size; None where it took no part."""
    other = translation.truth_of_target(frame)
    if other is None or other[0].reference is None or other[0].image.shape[:2] != translation.target.camera.shape:
        return None
    known = other[1] is not None and other[1].indentation_mm is not None and other[1].contact is not None
    return recorded(*other) if known else recorded_only(other[0])
