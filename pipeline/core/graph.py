"""On-demand evaluation of stages by methods.

A stage produces a value that people look at (a depth map, a touch, a pose); a method is one
implementation of it. A method runs only if its stage is requested, not cached, and needed by the
scene. Its key is a digest of stage, method, parameters and the *contents* of its inputs, so an
equal output after a change stops the recomputation below it (early cutoff, Salsa's backdating),
whichever method produced it.

A method may be a chain of nodes: methods that no column shows, each with a key of its own, so that
a change repeats only what reads it. What a method reads of stages that its route leaves out is
evaluated in the same way.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, TypeVarTuple, Unpack, cast

import xxhash

from pipeline.core import compiling
from pipeline.core.digests import DigestCache, compute_digest
from pipeline.core.errors import ChangeNote, SettingProblem, StageWarning, select_warnings
from pipeline.core.frozen import frozen
from pipeline.core.memo import Cache, CacheEntry, measure_bytes
from pipeline.core.params import is_draft
from pipeline.core.progress import SILENT, Progress, SubProgress

if TYPE_CHECKING:
    from typing_extensions import TypeVar as TypeVarWithDefault
    from typing_extensions import TypeVarTuple as TypeVarTupleWithDefault

    Params = TypeVarWithDefault("Params", default=Any)
    Output = TypeVarWithDefault("Output", default=Any)
    Reads = TypeVarTupleWithDefault("Reads", default=Unpack[tuple[Any, ...]])
else:  # Python 3.11 has no defaults of type variables
    Params = TypeVar("Params")
    Output = TypeVar("Output")
    Reads = TypeVarTuple("Reads")

State = Literal["computed", "cached", "unchanged", "skipped", "given"]


@frozen
class Skipped(Generic[Output]):
    """What a method returns when the scene needs no work: the exact answer, and why there was
    nothing to do.
    """

    output: Output
    reason: str


@frozen
class Fallback(Generic[Output]):
    """What a method returns when it cannot answer and another did: that one's answer, and why."""

    result: Output | Skipped[Output]
    reason: str  # "who answered: why; details"


NODE_MARK = "."  # in the name of a node's value, between stage and node


@frozen
class EarlyAnswer(Generic[Output]):
    """What a node returns when its output is already the value of the whole chain: later nodes
    do not run.
    """

    output: Output


@frozen
class Method(Generic[Params, Output, *Reads]):
    """One implementation of a stage: a function without side effects, its parameters, and its
    inputs.
    """

    stage: str
    name: str  # unique within its stage
    title: str
    run: Callable[
        [Unpack[Reads], Params, Progress],
        Output | Skipped[Output] | Fallback[Output] | EarlyAnswer[Any],
    ]
    params: type[Params]
    reads: tuple[str, ...]  # stages above it or inputs, in the order of `run`'s arguments
    # Of stages in `reads` that a route may leave out: there the first that fits the source is
    # evaluated with default parameters, as a node that no column shows.
    defaults: tuple[Method, ...] = ()
    # raised when equal inputs give another output: frames on disk are then made again
    version: int = 1
    help: str = ""  # what it does, in half a sentence
    kinds: tuple[str, ...] = ()  # of the sensors that it is for; () = all
    # (source, target, file) -> input `weights_name`; None = no weights
    weights: Callable[..., object] | None = None
    # of a chain, whose `run` is `chain_nodes(nodes, reads)`; the last makes the value
    nodes: tuple[Method, ...] = ()
    # of a node: its own of the chain's parameters
    select_params: Callable[[Any], Params] | None = None
    value_type: type[Any] = object  # that `run` must return; of one of its own, its stage's
    # parameters -> cheaper ones for dragging; None = no draft
    draft: Callable[[Params], Params] | None = None

    def fits(self, kind: str) -> bool:
        """Return whether it is for sensors of this kind; "" = not known yet."""
        return not (self.kinds and kind) or kind in self.kinds

    @property
    def weights_name(self) -> str:
        """Name of the input that holds its weights."""
        return f"{self.stage}_weights"

    @property
    def key(self) -> str:
        """Key under which its parameters are stored."""
        return f"{self.stage}/{self.name}"


@frozen
class StageResult:
    """A stage's result, its time, and how it came about."""

    name: str  # of the stage
    method: Method | None  # None = the value was given as input
    output: Any
    state: State
    ms: float
    notes: tuple[str, ...]
    digest: str
    fallback: str = ""  # why another method gave the result; "" = it did not
    draft: bool = False  # whether it or one of its inputs was computed with draft parameters
    # of a chain, as far as it had to be evaluated, without their outputs
    nodes: tuple[StageResult, ...] = ()
    ends_chain: bool = False  # of a node: whether its output is that of the whole chain

    @property
    def answered_by(self) -> str:
        """Title of what gave the result: of the method that another answered for, what did.

        "Truth" for a truth.
        """
        if self.fallback:
            return self.fallback.partition(":")[0]
        return "Truth" if self.method is None else self.method.title

    @property
    def badge(self) -> str:
        """What gave the result, in a few words: why another method did, or what the network
        changed; "" = not said.
        """
        return self.fallback.partition(";")[0] or next(
            (n for n in self.notes if isinstance(n, ChangeNote)), ""
        )

    @property
    def warnings(self) -> tuple[StageWarning, ...]:
        """Warnings about the result; none for a skipped stage."""
        return () if self.state == "skipped" else select_warnings(self.notes)


StageResults = Mapping[str, StageResult]  # stage -> its result


def skip_if_exact(
    exact: Callable[..., Output | None],
    run: Callable[[Unpack[Reads], Params, Progress], Output | Skipped[Output] | Fallback[Output]],
) -> Callable[[Unpack[Reads], Params, Progress], Output | Skipped[Output] | Fallback[Output]]:
    """Return a method's function: the result of `exact` (*reads, params) if it has one, that of
    `run` otherwise.
    """

    def run_if_needed(
        *args: *tuple[*Reads, Params, Progress],
    ) -> Output | Skipped[Output] | Fallback[Output]:
        output = exact(*args[:-1])
        if output is None:
            return run(*args)
        notes: tuple[str, ...] = getattr(output, "notes", ())
        return Skipped(output=output, reason=(*notes, "nothing to do")[0])

    return run_if_needed


def chain_nodes(nodes: Sequence[Method], reads: Sequence[str]) -> Callable[..., Any]:
    """Return the function (*reads, params, progress) of a chain: its nodes in order, without a
    cache.

    A node reads what the chain reads, under the names `reads`, and the outputs of earlier nodes.
    One that returns Skipped, Fallback or EarlyAnswer gives the value of the whole chain, and later
    nodes do not run.
    """

    def run_chain(*args: Any) -> Any:
        *given, params, progress = args
        return run_nodes(nodes, dict(zip(reads, given, strict=True)), params, progress)

    return run_chain


def run_nodes(
    nodes: Sequence[Method], values: dict[str, Any], params: Any, progress: Progress
) -> Any:
    """Run the nodes of a chain in order, without a cache.

    Returns its value, and adds those of its nodes to `values`.

    A node whose value is among `values` does not run.
    """
    answer = None
    for index, node in enumerate(nodes):
        if node.stage in values:
            continue
        run: Callable[..., Any] = node.run
        own = params if node.select_params is None else node.select_params(params)
        part = SubProgress(progress, index / len(nodes), 1.0 / len(nodes), node.title)
        answer = run(*(values[name] for name in node.reads), own, part)
        if isinstance(answer, EarlyAnswer):
            return cast("Any", answer).output
        if isinstance(answer, Skipped | Fallback):
            break
        values[node.stage] = answer
    return answer


@dataclass(slots=True)
class Graph:
    """Evaluates the methods of one route, one per stage.

    Its only state is the cache, so threads may share it.
    """

    methods: Sequence[Method]
    cache: Cache = field(default_factory=Cache)
    _digests: DigestCache = field(default_factory=DigestCache)

    def with_methods(self, methods: Sequence[Method]) -> Graph:
        """Return a graph of other methods with the same cache."""
        return replace(self, methods=methods)

    def evaluate(
        self,
        wanted: Iterable[str],
        inputs: Mapping[str, object],
        params: Mapping[str, object],
        progress: Progress = SILENT,
        on_stage: Callable[[StageResult], None] | None = None,
    ) -> dict[str, StageResult]:
        """Return results of the `wanted` stages and of those they depend on, in order.

        `inputs` are the values that no method produces; one under a stage's name replaces that
        stage, whose method does not run (ground truth there attributes the error). `params` maps
        stages to parameters of their methods; a missing entry, or one of another method, means
        defaults. Raises SettingProblem for an unknown name, Cancelled when `progress` says so, and
        whatever a method raises.
        """
        order = self.select_methods(
            wanted, inputs.keys(), getattr(inputs.get("source"), "kind", "")
        )
        digests = {name: self._digests.compute_digest(value) for name, value in inputs.items()}
        values: dict[str, object] = dict(inputs)
        results: dict[str, StageResult] = {}
        fresh = set[str]()
        drafts = set[str]()
        for index, method in enumerate(order):
            part = SubProgress(progress, index / len(order), 1.0 / len(order), method.title)
            part.step(0.0, "")
            if method.stage in inputs:
                value = values[method.stage]
                result = StageResult(
                    name=method.stage,
                    method=None,
                    output=value,
                    state="given",
                    ms=0.0,
                    notes=tuple(getattr(value, "notes", ())),
                    digest=digests[method.stage],
                )
            else:
                own = params.get(method.stage) if method in self.methods else None
                own = own if isinstance(own, method.params) else method.params()
                evaluate = self._evaluate_chain if method.nodes else self._evaluate_method
                result = evaluate(method, values, digests, own, fresh, part)
                if is_draft(own) or drafts.intersection(method.reads):
                    drafts.add(method.stage)
                    result = replace(result, draft=True)
            values[method.stage] = result.output
            digests[method.stage] = result.digest
            if result.state not in ("cached", "given"):
                fresh.add(method.stage)
            if method in self.methods:
                results[method.stage] = result
                if on_stage is not None:
                    on_stage(result)
        progress.step(1.0, "")
        return results

    def list_methods(self, kind: str = "") -> tuple[Method, ...]:
        """Return the route's methods, each after those of what it reads and the route leaves
        out, for a kind.
        """
        stages = {m.stage for m in self.methods}
        methods = list[Method]()
        for method in self.methods:
            for default in method.defaults:
                if default.stage not in stages and default.fits(kind):
                    stages.add(default.stage)
                    methods.append(default)
            methods.append(method)
        return tuple(methods)

    def select_methods(
        self, wanted: Iterable[str], given: Iterable[str] = (), kind: str = ""
    ) -> tuple[Method, ...]:
        """Return the methods of the wanted stages and of what they read, in running order.

        Given stages read nothing.

        `kind` is that of the source, by which methods of stages that the route leaves out are
        chosen.
        """
        names = set(wanted)
        given = set(given)
        unknown = names - {m.stage for m in self.methods}
        if unknown:
            known = ", ".join(m.stage for m in self.methods)
            raise SettingProblem(
                f"no stage {sorted(unknown)[0]!r} on this route; there are {known}"
            )
        methods = self.list_methods(kind)
        for method in reversed(methods):
            if method.stage in names and method.stage not in given:
                names.update(method.reads)
        return tuple(m for m in methods if m.stage in names)

    def _evaluate_method(
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
            raise SettingProblem(
                f"{method.stage} by {method.title!r} needs {missing[0]!r}, which this route lacks"
            )
        key = _key(method, params, [digests[name] for name in method.reads])
        entry = self.cache.get(key)
        if entry is not None:
            state: State = "unchanged" if fresh.intersection(method.reads) else "cached"
        else:
            entry = self._run_method(
                method, [values[name] for name in method.reads], params, progress
            )
            self.cache.put(key, entry)
            state = "computed"
        notes = tuple(getattr(entry.output, "notes", ()))
        if entry.skip_reason:
            state = "skipped"
            notes = tuple(dict.fromkeys((entry.skip_reason, *notes)))
        if entry.fallback:
            notes = (entry.fallback, *notes)
        ms = 1e3 * (time.perf_counter() - compiling.spent_s() - started)
        return StageResult(
            name=method.stage,
            method=method,
            output=entry.output,
            state=state,
            ms=ms,
            notes=notes,
            digest=entry.digest,
            fallback=entry.fallback,
            ends_chain=entry.ends_chain,
        )

    def _evaluate_chain(
        self,
        method: Method,
        values: Mapping[str, object],
        digests: Mapping[str, str],
        params: object,
        fresh: set[str],
        progress: Progress,
    ) -> StageResult:
        values = dict(values)
        digests = dict(digests)
        results = list[StageResult]()
        for index, node in enumerate(method.nodes):
            own = params if node.select_params is None else node.select_params(params)
            part = SubProgress(
                progress, index / len(method.nodes), 1.0 / len(method.nodes), node.title
            )
            result = self._evaluate_method(node, values, digests, own, fresh, part)
            results.append(result)
            if result.state == "skipped" or result.fallback or result.ends_chain:
                break
            values[node.stage] = result.output
            digests[node.stage] = result.digest
            if result.state != "cached":
                fresh.add(node.stage)
        return replace(
            results[-1],
            name=method.stage,
            method=method,
            ms=sum(r.ms for r in results),
            nodes=tuple(replace(r, output=None) for r in results),
        )

    def _run_method(
        self, method: Method, reads: Sequence[object], params: object, progress: Progress
    ) -> CacheEntry:
        run: Callable[..., Any] = method.run  # values by name have no static type here
        answer = run(*reads, params, progress)
        instead = answer.reason if isinstance(answer, Fallback) else ""
        answer = answer.result if isinstance(answer, Fallback) else answer
        why = answer.reason if isinstance(answer, Skipped) else ""
        output = answer.output if isinstance(answer, Skipped | EarlyAnswer) else answer
        if not isinstance(output, method.value_type):
            wanted = method.value_type.__name__
            raise SettingProblem(
                f"{method.stage} by {method.title!r} returned a {type(output).__name__}; "
                f"return a {wanted}"
            )
        # a skipped result may be the object that was returned before
        made = self._digests.compute_digest(output) if why else compute_digest(output)
        # Arrays shared with inputs and other stages are counted where they were made. Nodes of a
        # chain leave the cache one by one, so that what they share is counted with each.
        besides = [
            value for name, value in zip(method.reads, reads, strict=True) if NODE_MARK not in name
        ]
        n_bytes = measure_bytes(output, besides)
        return CacheEntry(
            output=output,
            digest=made,
            n_bytes=n_bytes,
            skip_reason=why,
            fallback=instead,
            ends_chain=isinstance(answer, EarlyAnswer),
        )


def _key(method: Method, params: object, reads: Sequence[str]) -> str:
    text = f"{method.stage}|{method.name}|{params!r}|{'|'.join(reads)}"
    return xxhash.xxh3_128_hexdigest(text.encode())
