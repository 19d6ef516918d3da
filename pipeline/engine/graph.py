"""Slots filled by methods, on demand.

A slot is a value that people look at (a depth map, a touch, a pose); a method is one way to fill it. A method runs
only if somebody wants its slot, nobody has worked it out before, and the scene needs it. Its key is a digest of slot,
method, version, parameters and the *contents* of what it reads, so a slot that comes out equal after a change stops the
recomputation below it (early cutoff, Salsa's backdating), whichever method filled it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import xxhash

from pipeline.base import compiling
from pipeline.base.errors import SettingProblem
from pipeline.base.memo import measure_bytes
from pipeline.base.params import is_draft
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.base.stage_warnings import StageWarning, select_warnings
from pipeline.engine.cache import Cache, CacheEntry
from pipeline.engine.digests import DigestCache, compute_digest

State = Literal["computed", "cached", "unchanged", "skipped", "given"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Skipped:
    """What a method returns when the scene needs no work: the exact answer, and why there was nothing to do."""

    output: Any
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Fallback:
    """What a method returns when it cannot answer and another did: that one's answer, and why."""

    result: Any  # an output, or `Skipped`
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One way to fill a slot: a pure function, its parameters, and what it reads."""

    stage: str
    name: str  # unique in its slot
    title: str
    run: Callable[..., Any]  # (*reads, params, progress) -> the slot's value, or `Skipped`
    params: type[Any]
    reads: tuple[str, ...]  # slots above it or inputs, in the order of `run`'s arguments
    version: int = 1  # raised whenever the same inputs give another output
    help: str = ""  # what it does, in half a sentence
    weights: Callable[..., object] | None = None  # (source, target, file) -> input `weights_name`; None = it reads none

    draft: Callable[[Any], Any] | None = None  # parameters -> cheaper ones, while one is dragged; None = as they are

    @property
    def weights_name(self) -> str:
        """The input that its weights are read under."""
        return f"{self.stage}_weights"

    @property
    def key(self) -> str:
        """What its parameters are kept under."""
        return f"{self.stage}/{self.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class StageResult:
    """What a slot holds this time, how long that took, and why it took no longer."""

    name: str  # of the slot
    method: Method | None  # None = the value was given in its place
    output: Any
    state: State
    ms: float
    notes: tuple[str, ...]
    digest: str
    fallback: str = ""  # why another method answered; "" = this one did
    draft: bool = False  # it, or something that it rests on, was worked out by cheaper parameters than asked for

    @property
    def warnings(self) -> tuple[StageWarning, ...]:
        """What speaks against the answer; none of one that needed no work."""
        return () if self.state == "skipped" else select_warnings(self.notes)


def skip_if_exact(exact: Callable[..., Any], run: Callable[..., Any]) -> Callable[..., Any]:
    """A method's function of two: `exact` (*reads, params) answers where there is nothing to do, `run` otherwise."""

    def filled(*args: Any) -> Any:
        output = exact(*args[:-1])
        return run(*args) if output is None else Skipped(output=output, reason=(*output.notes, "nothing to do")[0])

    return filled


@dataclass(slots=True)
class Graph:
    """Evaluates the methods of one route, one a slot; holds nothing but the cache, so threads may share it."""

    methods: Sequence[Method]
    cache: Cache = field(default_factory=Cache)
    _known: DigestCache = field(default_factory=DigestCache)

    def with_methods(self, methods: Sequence[Method]) -> Graph:
        """A graph of other methods that remembers what this one has worked out."""
        return replace(self, methods=methods)

    def evaluate(
        self,
        wanted: Iterable[str],
        inputs: Mapping[str, object],
        params: Mapping[str, object],
        progress: Progress = SILENT,
        on_stage: Callable[[StageResult], None] | None = None,
    ) -> dict[str, StageResult]:
        """Results of the `wanted` slots and of those they rest on, in order.

        `inputs` are the values that no method makes; one under a slot's name stands for that slot, whose method then
        does not run (truth in its place tells what the slot is to blame for). `params` maps slots to the parameters of
        their methods; one that is left out, or that is another method's, runs on its defaults.
        Raises SettingProblem for an unknown name, Cancelled when `progress` says so, and whatever a method raises.
        """
        order = self.select_methods(wanted, given=inputs.keys())
        digests = {name: self._known.compute_digest(value) for name, value in inputs.items()}
        values: dict[str, object] = dict(inputs)
        results: dict[str, StageResult] = {}
        fresh, drafts = set[str](), set[str]()
        for index, method in enumerate(order):
            part = SubProgress(progress, index / len(order), 1.0 / len(order), method.title)
            part.step(0.0, "")
            if method.stage in inputs:
                result = _given(method.stage, values[method.stage], digests[method.stage])
            else:
                own = _fitting(params, method)
                result = self._one(method, values, digests, own, fresh, part)
                if is_draft(own) or drafts.intersection(method.reads):
                    drafts.add(method.stage)
                    result = replace(result, draft=True)
            values[method.stage], digests[method.stage] = result.output, result.digest
            results[method.stage] = result
            if result.state not in ("cached", "given"):
                fresh.add(method.stage)
            if on_stage is not None:
                on_stage(result)
        progress.step(1.0, "")
        return results

    def select_methods(self, wanted: Iterable[str], given: Iterable[str] = ()) -> tuple[Method, ...]:
        """The methods of the wanted slots and of all that they read, in running order; a given slot reads nothing."""
        names, given = set(wanted), set(given)
        unknown = names - {m.stage for m in self.methods}
        if unknown:
            known = ", ".join(m.stage for m in self.methods)
            raise SettingProblem(f"no slot {sorted(unknown)[0]!r} on this route; there are {known}")
        for method in reversed(self.methods):
            if method.stage in names and method.stage not in given:
                names.update(method.reads)
        return tuple(m for m in self.methods if m.stage in names)

    def _one(
        self,
        method: Method,
        values: Mapping[str, object],
        digests: Mapping[str, str],
        params: object,
        fresh: set[str],
        progress: Progress,
    ) -> StageResult:
        started = time.perf_counter() - compiling.spent_s()
        missing = [name for name in method.reads if name not in values]
        if missing:
            raise SettingProblem(f"{method.stage} by {method.title!r} needs {missing[0]!r}, which this route lacks")
        key = _key(method, params, [digests[name] for name in method.reads])
        entry = self.cache.get(key)
        if entry is not None:
            state: State = "unchanged" if fresh.intersection(method.reads) else "cached"
        else:
            entry = self._work(method, [values[name] for name in method.reads], params, progress)
            self.cache.put(key, entry)
            state = "computed"
        notes = tuple(getattr(entry.output, "notes", ()))
        if entry.skip_reason:
            state, notes = "skipped", tuple(dict.fromkeys((entry.skip_reason, *notes)))
        if entry.fallback:
            notes = (entry.fallback, *notes)
        ms = 1e3 * (time.perf_counter() - compiling.spent_s() - started)
        return StageResult(
            name=method.stage, method=method, output=entry.output, state=state, ms=ms, notes=notes, digest=entry.digest,
            fallback=entry.fallback,
        )  # fmt: skip

    def _work(self, method: Method, reads: Sequence[object], params: object, progress: Progress) -> CacheEntry:
        answer = method.run(*reads, params, progress)
        instead = answer.reason if isinstance(answer, Fallback) else ""
        answer = answer.result if isinstance(answer, Fallback) else answer
        why = answer.reason if isinstance(answer, Skipped) else ""
        output = answer.output if isinstance(answer, Skipped) else answer
        # An answer without work may well be the very object that was given before.
        made = self._known.compute_digest(output) if why else compute_digest(output)
        n_bytes = measure_bytes(output, reads)  # what is handed on was weighed where it was made
        return CacheEntry(output=output, digest=made, n_bytes=n_bytes, skip_reason=why, fallback=instead)


def _fitting(params: Mapping[str, object], method: Method) -> object:
    given = params.get(method.stage)
    return given if isinstance(given, method.params) else method.params()


def _given(slot: str, value: object, made: str) -> StageResult:
    notes = tuple(getattr(value, "notes", ()))
    return StageResult(name=slot, method=None, output=value, state="given", ms=0.0, notes=notes, digest=made)


def _key(method: Method, params: object, reads: Sequence[str]) -> str:
    text = f"{method.stage}|{method.name}|{method.version}|{params!r}|{'|'.join(reads)}"
    return xxhash.xxh3_128_hexdigest(text.encode())
