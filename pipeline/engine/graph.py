"""The stages as data, and their evaluation on demand.

A stage runs only if somebody wants its output, nobody has worked it out before, and the scene needs it. Its key is
a digest of its name, version, parameters and input contents. Since keys below are made of the *contents* of outputs
above, a stage that comes out equal after a change stops the recomputation there (early cutoff, Salsa's backdating).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import xxhash

from pipeline.base import compiling
from pipeline.base.errors import SettingProblem
from pipeline.base.memo import size_bytes
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.cache import Cache, Entry
from pipeline.engine.digests import Known, digest

State = Literal["computed", "cached", "unchanged", "skipped"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One step of the paper: a pure function, what it reads, and its way out when there is nothing to do."""

    name: str
    title: str
    run: Callable[..., Any]  # (*reads, params, progress) -> output
    shortcut: Callable[..., Any]  # (*reads, params) -> exact output without running, or None
    params: type[Any]
    reads: tuple[str, ...]  # earlier stages or inputs, in the order of `run`'s arguments
    version: int = 1  # raised whenever the same inputs give another output


@dataclass(frozen=True, slots=True, kw_only=True)
class StageResult:
    """What a stage gave this time, how long that took, and why it took no longer."""

    name: str
    output: Any
    state: State
    ms: float
    notes: tuple[str, ...]
    digest: str


class _Part:
    """The share of a longer progress that one stage has."""

    def __init__(self, whole: Progress, index: int, count: int, title: str) -> None:
        self._whole, self._index, self._count, self._title = whole, index, count, title

    def step(self, fraction: float, text: str) -> None:
        """Pass on as a fraction of the whole."""
        label = f"{self._title}: {text}" if text else self._title
        self._whole.step((self._index + min(max(fraction, 0.0), 1.0)) / self._count, label)


@dataclass(slots=True)
class Graph:
    """Evaluates stages; holds nothing but the cache, so one graph may serve several threads."""

    stages: Sequence[Stage]
    cache: Cache = field(default_factory=Cache)
    _known: Known = field(default_factory=Known)

    def evaluate(
        self,
        wanted: Iterable[str],
        inputs: Mapping[str, object],
        params: Mapping[str, object],
        progress: Progress = SILENT,
        on_stage: Callable[[StageResult], None] | None = None,
    ) -> dict[str, StageResult]:
        """Results of the `wanted` stages and of those they rest on, in order.

        `inputs` are the values that no stage makes; `params` may leave a stage out, which then runs on its defaults.
        Raises SettingProblem for an unknown name, Cancelled when `progress` says so, and whatever a stage raises.
        """
        order = self.needed(wanted)
        digests = {name: self._known.digest(value) for name, value in inputs.items()}
        values: dict[str, object] = dict(inputs)
        results: dict[str, StageResult] = {}
        fresh: set[str] = set()
        for index, stage in enumerate(order):
            part = _Part(progress, index, len(order), stage.title)
            part.step(0.0, "")
            result = self._one(stage, values, digests, params.get(stage.name) or stage.params(), fresh, part)
            values[stage.name], digests[stage.name], results[stage.name] = result.output, result.digest, result
            if result.state != "cached":
                fresh.add(stage.name)
            if on_stage is not None:
                on_stage(result)
        progress.step(1.0, "")
        return results

    def needed(self, wanted: Iterable[str]) -> tuple[Stage, ...]:
        """The wanted stages and all that they read, in running order."""
        names = set(wanted)
        unknown = names - {s.name for s in self.stages}
        if unknown:
            known = ", ".join(s.name for s in self.stages)
            raise SettingProblem(f"no stage {sorted(unknown)[0]!r}; there are {known}")
        for stage in reversed(self.stages):
            if stage.name in names:
                names.update(stage.reads)
        return tuple(s for s in self.stages if s.name in names)

    def _one(
        self,
        stage: Stage,
        values: Mapping[str, object],
        digests: Mapping[str, str],
        params: object,
        fresh: set[str],
        progress: Progress,
    ) -> StageResult:
        started = time.perf_counter() - compiling.spent_s()
        missing = [name for name in stage.reads if name not in values]
        if missing:
            raise SettingProblem(f"stage {stage.name!r} needs {missing[0]!r}, which was not given")
        key = self._key(stage, params, [digests[name] for name in stage.reads])
        entry = self.cache.get(key)
        if entry is not None:
            state: State = "unchanged" if fresh.intersection(stage.reads) else "cached"
        else:
            entry = self._work(stage, [values[name] for name in stage.reads], params, progress)
            self.cache.put(key, entry)
            state = "computed"
        if entry.was_shortcut:
            state = "skipped"
        ms = 1e3 * (time.perf_counter() - compiling.spent_s() - started)
        notes = tuple(getattr(entry.output, "notes", ()))
        return StageResult(name=stage.name, output=entry.output, state=state, ms=ms, notes=notes, digest=entry.digest)

    def _work(self, stage: Stage, reads: Sequence[object], params: object, progress: Progress) -> Entry:
        output = stage.shortcut(*reads, params)
        was_shortcut = output is not None
        if output is None:
            output = stage.run(*reads, params, progress)
        # A shortcut may well give the very object that it gave before.
        made = self._known.digest(output) if was_shortcut else digest(output)
        return Entry(output=output, digest=made, n_bytes=size_bytes(output), was_shortcut=was_shortcut)

    @staticmethod
    def _key(stage: Stage, params: object, reads: Sequence[str]) -> str:
        text = f"{stage.name}|{stage.version}|{params!r}|{'|'.join(reads)}"
        return xxhash.xxh3_128_hexdigest(text.encode())
