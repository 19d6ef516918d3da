"""Variants of one frame: translations that differ in a method, a seed, parameter values or any
setting.

One runner evaluates them all, with one cache, so that what they have in common is computed once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

from pipeline.core.errors import TouchError
from pipeline.core.frozen import frozen
from pipeline.core.graph import Graph, Method, StageResult
from pipeline.core.memo import Cache, Memo
from pipeline.core.params import Value, replace_value
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.stages.networks.weights import NoWeights
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview
from pipeline.views.view import PreviewContext

_CACHE_BYTES = 64 * 1024 * 1024  # a dozen frames by every touch method
_MAX_TIMES = 4096  # stage times remembered

MethodParams = Mapping[str, object]  # method key -> parameters; methods left out use their defaults


@frozen
class Variant:
    """An opened translation with the parameters of its methods."""

    label: str
    translation: Translation
    params: MethodParams

    @property
    def stage_params(self) -> dict[str, object]:
        """Stage -> parameters of the method that computes it."""
        return {m.stage: self.params.get(m.key, m.params()) for m in self.translation.methods}

    def with_value(self, method: Method, name: str, value: Value) -> Variant:
        """The same with another value of one parameter."""
        changed = replace_value(self.params.get(method.key, method.params()), name, value)
        return replace(self, params={**self.params, method.key: changed})


@frozen
class VariantResult:
    """Stages of one variant on one frame; without results `problem` says why."""

    variant: Variant
    frame: int
    results: Mapping[str, StageResult] = field(default_factory=dict[str, StageResult])
    ms: float = math.nan  # time of all results, each as when it was computed; NaN if not measured
    problem: str = ""

    def compute_metrics(self) -> dict[str, float]:
        """`stage.name` -> value of all metrics that the frame's ground truth allows."""
        return self.variant.translation.compute_metrics(self.results, self.frame)

    def make_context(self, display: DisplayParams) -> PreviewContext:
        """What the stages' previews are drawn from."""
        return self.variant.translation.make_preview_context(self.results, display)

    def make_preview(self, stage: str, display: DisplayParams) -> Preview:
        """Preview of one stage."""
        view = self.variant.translation.catalogue.views[stage]
        return view.make_preview(self.results[stage].output, self.make_context(display))


class VariantRunner:
    """Evaluates variants with one cache and remembers how long each stage took.

    Used by one thread at a time.
    """

    def __init__(self, like: Graph | None = None) -> None:
        """Shares the cache of the graph `like`, if given."""
        self.graph = like or Graph((), cache=Cache(_CACHE_BYTES))
        self._times_ms: Memo[tuple[str, str], float] = Memo(_MAX_TIMES)
        self._loaded: set[str] = set()  # keys of methods whose network is loaded

    def evaluate(
        self,
        variant: Variant,
        frame: int,
        stages: Sequence[str],
        progress: Progress = SILENT,
        *,
        timed: bool = False,
    ) -> VariantResult:
        """Compute `stages` of one frame.

        Raises TouchError. `timed` leaves out the time of loading networks.
        """
        translation = replace(variant.translation, graph=self.graph, params=variant.stage_params)
        results = translation.evaluate(frame, stages, progress)
        ms = math.nan
        if timed:
            for name, result in results.items():
                given = {other: r.output for other, r in results.items() if other != name}
                self._measure(translation, frame, result, given)
            ms = sum(
                self._times_ms.get(_time_key(result)) or result.ms for result in results.values()
            )
        return VariantResult(variant=variant, frame=frame, results=results, ms=ms)

    def evaluate_all(
        self,
        variants: Sequence[Variant],
        frame: int,
        stages: Sequence[str],
        progress: Progress = SILENT,
    ) -> Iterator[VariantResult]:
        """Results one after the other, timed; one that fails has its problem. Raises Cancelled."""
        for index, variant in enumerate(variants):
            part = SubProgress(progress, index / len(variants), 1.0 / len(variants), variant.label)
            part.step(0.0, "")
            try:
                yield self.evaluate(variant, frame, stages, part, timed=True)
            except TouchError as error:
                yield VariantResult(variant=variant, frame=frame, problem=str(error))

    def clear(self) -> None:
        """Drop cached results; measured times are kept."""
        self.graph.cache.clear()
        self._loaded.clear()

    def _measure(
        self, translation: Translation, frame: int, result: StageResult, given: Mapping[str, object]
    ) -> None:
        """Remember a computed stage's time.

        The first run of a network is repeated, as it includes loading.
        """
        method = result.method
        key = _time_key(result)
        if result.state != "computed" and self._times_ms.get(key) is not None:
            return
        ms = result.ms
        is_computed = result.state == "computed" and not result.fallback
        if method and method.weights and is_computed and method.key not in self._loaded:
            self._loaded.add(method.key)
            anew = replace(translation, graph=Graph(()))
            ms = anew.evaluate(frame, [result.name], given=given)[result.name].ms
        self._times_ms.put(key, ms)


def _time_key(result: StageResult) -> tuple[str, str]:
    return ("" if result.method is None else result.method.key, result.digest)


def choose_methods(
    translation: Translation, methods: Mapping[str, str], weights: Mapping[str, Path]
) -> Translation:
    """The translation with other methods (stage -> name) and weights, besides those it has."""
    request = translation.request
    chosen = {**dict(request.methods), **methods}
    files = {**dict(request.weights), **weights}
    request = replace(request, methods=tuple(chosen.items()), weights=tuple(files.items()))
    return replace(translation, request=request)


def list_method_variants(
    translation: Translation, params: MethodParams, stage: str
) -> tuple[tuple[Variant, ...], tuple[str, ...]]:
    """(a variant per method of a stage in the catalogue's order, sentences about methods without
    weights).

    A network needs weights of this direction; a weights file that the translation names is tried
    first. Raises SettingProblem if there is no such stage.
    """
    given = dict(translation.request.weights).get(stage)
    others = tuple(pair for pair in translation.request.weights if pair[0] != stage)
    variants: list[Variant] = []
    excluded: list[str] = []
    for method in translation.catalogue.stage(stage).methods:
        base = translation
        if method.weights is not None:
            found = method.weights(translation.source, translation.target, given)
            if isinstance(found, NoWeights) and given is not None:
                base = replace(base, request=replace(base.request, weights=others))
                found = method.weights(translation.source, translation.target, None)
            if isinstance(found, NoWeights):
                excluded.append(f"{method.title}: {found.why.partition(';')[0]}")
                continue
        chosen = choose_methods(base, {stage: method.name}, {})
        variants.append(Variant(label=method.title, translation=chosen, params=params))
    return tuple(variants), tuple(excluded)
