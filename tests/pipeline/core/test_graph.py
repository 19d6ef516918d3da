from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.arrays import freeze
from pipeline.core.digests import DigestCache, compute_digest
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.graph import (
    EarlyAnswer,
    Fallback,
    Graph,
    Method,
    Skipped,
    chain_nodes,
    skip_if_exact,
)
from pipeline.core.memo import Cache, CacheEntry
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Cancelled


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    value: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Add:
    amount: float = setting(1.0, "Amount")


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    kind: str


@dataclass
class Ran:
    """Which stages really ran, in order."""

    names: list[str] = field(default_factory=list)

    def stage(self, name, reads, work, shortcut=lambda *_: None):
        def run(*arguments):
            self.names.append(name)
            *values, params, progress = arguments
            progress.step(0.5, "half way")
            return work(*values, params)

        return Method(
            stage=name,
            name="only",
            title=name,
            run=skip_if_exact(shortcut, run),
            params=Add,
            reads=reads,
        )


@pytest.fixture
def ran():
    return Ran()


@pytest.fixture
def graph(ran):
    return Graph(
        (
            ran.stage("double", ("x",), lambda x, p: Number(value=2 * x.value * p.amount)),
            ran.stage(
                "sign",
                ("double",),
                lambda d, p: Number(value=float(np.sign(d.value)), notes=("signed",)),
            ),
            ran.stage("last", ("sign", "y"), lambda s, y, p: Number(value=s.value + y.value)),
        )
    )


X = Number(value=3.0)
Y = Number(value=10.0)


def test_only_what_is_wanted_and_what_it_rests_on_runs(graph, ran):
    results = graph.evaluate(["sign"], {"x": X}, {})
    assert ran.names == ["double", "sign"]
    assert results["sign"].output.value == 1.0
    assert results["sign"].notes == ("signed",)


def test_the_second_time_nothing_runs(graph, ran):
    graph.evaluate(["last"], {"x": X, "y": Y}, {})
    ran.names.clear()
    results = graph.evaluate(["last"], {"x": Number(value=3.0), "y": Y}, {})
    assert ran.names == []
    assert {r.state for r in results.values()} == {"cached"}


def test_a_changed_parameter_reruns_its_stage_and_what_follows_only(graph, ran):
    graph.evaluate(["last"], {"x": X, "y": Y}, {})
    ran.names.clear()
    graph.evaluate(["last"], {"x": X, "y": Y}, {"last": Add(amount=2.0)})
    assert ran.names == ["last"]


def test_an_equal_output_stops_the_recomputation_below_it(graph, ran):
    graph.evaluate(["last"], {"x": X, "y": Y}, {})
    ran.names.clear()
    results = graph.evaluate(["last"], {"x": Number(value=4.0), "y": Y}, {})
    assert ran.names == ["double", "sign"]
    assert results["last"].state == "unchanged"


def test_a_stage_that_the_route_leaves_out_is_evaluated_unseen_with_defaults(ran):
    double = ran.stage("double", ("x",), lambda x, p: Number(value=2 * x.value * p.amount))
    of_others = replace(double, name="of_others", kinds=("other",))
    last = replace(
        ran.stage("last", ("double", "y"), lambda d, y, p: Number(value=d.value + y.value)),
        defaults=(of_others, double),
    )
    seen = []
    inputs = {"x": X, "y": Y, "source": Source(kind="this")}
    graph = Graph((last,))
    params = {"double": Add(amount=5.0)}
    results = graph.evaluate(
        ["last"], inputs, params, on_stage=lambda result: seen.append(result.name)
    )
    assert list(results) == seen == ["last"]
    assert results["last"].output.value == 16.0, (
        "parameters of a column that is not there do not reach it"
    )
    assert graph.evaluate(["last"], inputs, {})["last"].state == "cached"
    assert ran.names == ["double", "last"]
    whole = graph.with_methods((double, last)).evaluate(["last"], inputs, params)
    assert whole["last"].output.value == 40.0, "the route's own method and its parameters reach it"
    assert graph.evaluate(["last"], {**inputs, "double": Y}, {})["last"].output.value == 20.0
    assert [m.name for m in graph.list_methods("other")] == ["of_others", "only"]


def test_a_shortcut_answers_without_running_and_says_so(ran):
    stage = ran.stage(
        "s", ("x",), lambda x, p: X, shortcut=lambda x, p: Y if x.value == 0 else None
    )
    graph = Graph((stage,))
    for _ in range(2):
        assert graph.evaluate(["s"], {"x": Number(value=0.0)}, {})["s"].state == "skipped"
    assert ran.names == []
    assert graph.evaluate(["s"], {"x": X}, {})["s"].state == "computed"


def test_a_progress_that_cancels_stops_before_the_next_stage_and_leaves_the_cache_usable(
    graph, ran
):
    class StopInSecond:
        def step(self, fraction, text):
            if "sign" in text:
                raise Cancelled

    with pytest.raises(Cancelled):
        graph.evaluate(["last"], {"x": X, "y": Y}, {}, StopInSecond())
    assert ran.names == ["double"]
    graph.evaluate(["last"], {"x": X, "y": Y}, {})
    assert ran.names == ["double", "sign", "last"]


def test_progress_never_goes_back(graph):
    seen = []

    class Keep:
        def step(self, fraction, text):
            seen.append(fraction)

    graph.evaluate(["last"], {"x": X, "y": Y}, {}, Keep())
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_an_unknown_stage_and_a_missing_input_are_named(graph):
    with pytest.raises(SettingProblem, match=r"'colour'.*double, sign, last"):
        graph.evaluate(["colour"], {}, {})
    with pytest.raises(SettingProblem, match="'last' needs 'y'"):
        graph.evaluate(["last"], {"x": X}, {})


def test_the_cache_never_holds_more_bytes_than_allowed():
    cache = Cache(max_bytes=100)
    for i in range(20):
        cache.put(str(i), CacheEntry(output=i, digest="", n_bytes=30))
        assert cache.n_bytes <= 100
    assert len(cache) == 3
    cache.put("huge", CacheEntry(output=0, digest="", n_bytes=101))
    assert cache.get("huge") is None
    assert cache.get("19") is not None


def test_the_least_recently_used_entry_goes_first():
    cache = Cache(max_bytes=60)
    for name in ("a", "b"):
        cache.put(name, CacheEntry(output=name, digest="", n_bytes=30))
    cache.get("a")
    cache.put("c", CacheEntry(output="c", digest="", n_bytes=30))
    assert cache.get("b") is None
    assert cache.get("a") is not None


def test_digests_tell_apart_what_is_different_and_only_that():
    a = np.arange(6, dtype=np.float32)
    assert compute_digest(a) == compute_digest(a.copy())
    different = [
        a,
        a.astype(np.float64),
        a.reshape(2, 3),
        a + 1,
        1,
        1.0,
        True,
        "1",
        None,
        (1, 2),
        (1, (2,)),
        Number(value=1.0),
    ]
    assert len({compute_digest(v) for v in different}) == len(different)
    with pytest.raises(TypeError):
        compute_digest(object())


def test_digest_of_a_strided_view_is_that_of_its_contents():
    a = np.arange(24).reshape(4, 6)
    assert compute_digest(a[:, ::2]) == compute_digest(a[:, ::2].copy())


def test_known_digests_are_those_of_the_contents_and_the_longest_unused_goes_first():
    known = DigestCache(most=2)
    a, b, c = (freeze(np.full(3, k)) for k in range(3))
    for value in (a, b, a, c, a, b):
        assert known.compute_digest(value) == compute_digest(value)
        assert len(known) <= 2
    b_before = known.compute_digest(b)
    b.flags.writeable = True
    b[0] = 7  # nobody may do this; it shows that b is remembered, not read again
    assert known.compute_digest(b) == b_before
    known.compute_digest(a)
    known.compute_digest(c)
    assert known.compute_digest(b) == compute_digest(b) != b_before


@pytest.mark.parametrize("of", ["itself", "a view", "a frozen view", "a value"])
def test_what_can_be_changed_in_place_is_digested_anew(of):
    known = DigestCache()
    array = np.arange(6.0)
    value = {
        "itself": lambda: array,
        "a view": lambda: array.reshape(2, 3),
        "a frozen view": lambda: freeze(array[1:]),
        "a value": lambda: Mesh(
            vertices_mm=freeze(array[None]), triangles=freeze(np.zeros((1, 3), np.int32))
        ),
    }[of]()
    before = known.compute_digest(value)
    array[3] = 70.0
    assert known.compute_digest(value) == compute_digest(value) != before


def test_masked_arrays_differ_by_their_masks_and_by_what_these_leave_to_see():
    data = np.arange(4.0)
    hidden = np.array([False, True, False, False])
    masked = np.ma.MaskedArray(data, hidden)
    others = (
        data,
        np.ma.MaskedArray(data),
        np.ma.MaskedArray(data, ~hidden),
        np.ma.MaskedArray(data + 1, hidden),
    )
    assert len({compute_digest(value) for value in (masked, *others)}) == 5
    assert compute_digest(masked) == compute_digest(
        np.ma.MaskedArray(np.where(hidden, np.nan, data), hidden)
    )


def test_known_digests_may_be_asked_for_by_several_threads():
    known = DigestCache(most=3)
    values = [np.full(100, k) for k in range(12)]
    wanted = [compute_digest(v) for v in values]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(known.compute_digest, values * 20)) == wanted * 20


def test_sensors_stay_known_however_many_frames_pass(monkeypatch, ran):
    graph = Graph((ran.stage("s", ("x", "sensor"), lambda x, s, p: x),))
    sensor = Number(value=1.0)
    asked = []
    monkeypatch.setattr(
        "pipeline.core.digests.compute_digest",
        lambda value: asked.append(value) or compute_digest(value),
    )
    for k in range(100):
        graph.evaluate(["s"], {"x": Number(value=float(k)), "sensor": sensor}, {})
    assert sum(value is sensor for value in asked) == 1


def test_a_shortcut_that_gives_the_same_object_again_stops_the_recomputation_below_it(ran):
    rest = Number(value=0.0)
    first = ran.stage("first", ("x",), lambda x, p: x, shortcut=lambda x, p: rest)
    graph = Graph((first, ran.stage("last", ("first",), lambda r, p: r)))
    for k in range(3):
        results = graph.evaluate(["last"], {"x": Number(value=float(k))}, {})
        assert results["first"].digest == compute_digest(rest)
    assert ran.names == ["last"]
    assert results["last"].state == "unchanged"


def test_what_is_compiled_on_the_way_is_not_the_stages_time(ran, monkeypatch):
    now_s = [100.0]
    compiled_s = [3.0]

    def work(_x, _params):
        now_s[0] += 7.0
        compiled_s[0] += 5.0
        return Number(value=1.0)

    monkeypatch.setattr("pipeline.core.graph.time", SimpleNamespace(perf_counter=lambda: now_s[0]))
    monkeypatch.setattr("pipeline.core.compiling.spent_s", lambda: compiled_s[0])
    results = Graph((ran.stage("one", ("x",), work),)).evaluate(
        ("one",), {"x": Number(value=1.0)}, {}
    )
    assert results["one"].ms == pytest.approx(2000.0)


@pytest.mark.parametrize("change", [{"name": "other"}])
def test_another_method_runs_again_on_what_is_cached(ran, change):
    cache = Cache(1 << 20)
    method = ran.stage("double", ("x",), lambda x, p: Number(value=2 * x.value))
    for known in (method, method, replace(method, **change)):
        Graph((known,), cache=cache).evaluate(("double",), {"x": X}, {})
    assert ran.names == ["double", "double"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainParams:
    scale: float = setting(2.0, "Scale")
    shift: float = setting(0.5, "Shift")


@pytest.fixture
def chain(ran):
    """scale x, take the sign, shift: a chain of three nodes, of which the first reads one
    parameter alone.
    """

    def make(scaled=lambda x, p: Number(value=x.value * p.scale)):
        nodes = (
            replace(
                ran.stage("c.scaled", ("x",), scaled),
                params=ChainParams,
                select_params=lambda p: replace(p, shift=0.0),
            ),
            replace(
                ran.stage(
                    "c.sign", ("c.scaled",), lambda s, _p: Number(value=float(np.sign(s.value)))
                ),
                select_params=lambda _p: Add(),
            ),
            replace(
                ran.stage(
                    "c.shifted",
                    ("c.sign", "y"),
                    lambda s, y, p: Number(value=s.value + y.value + p.shift, notes=("end",)),
                ),
                select_params=lambda p: replace(p, scale=0.0),
                params=ChainParams,
            ),
        )
        reads = ("x", "y")
        return Method(
            stage="c",
            name="chain",
            title="Chain",
            run=chain_nodes(nodes, reads),
            params=ChainParams,
            reads=reads,
            nodes=nodes,
        )

    return make


def test_a_chain_repeats_only_the_nodes_that_read_a_changed_parameter(chain, ran):
    graph = Graph((chain(),))
    inputs = {"x": X, "y": Y}
    first = graph.evaluate(["c"], inputs, {})["c"]
    assert (first.output.value, first.notes, first.state, first.name) == (
        11.5,
        ("end",),
        "computed",
        "c",
    )
    assert [n.name for n in first.nodes] == ["c.scaled", "c.sign", "c.shifted"]
    ran.names.clear()
    shifted = graph.evaluate(["c"], inputs, {"c": ChainParams(shift=1.0)})["c"]
    assert (shifted.output.value, ran.names) == (12.0, ["c.shifted"])
    ran.names.clear()
    scaled = graph.evaluate(["c"], inputs, {"c": ChainParams(scale=3.0)})["c"]
    assert (scaled.state, ran.names) == ("unchanged", ["c.scaled", "c.sign"])
    assert graph.evaluate(["c"], inputs, {})["c"].state == "cached"


@pytest.mark.parametrize("kind", [Skipped, Fallback])
def test_a_node_that_answers_for_the_chain_ends_it(chain, ran, kind):
    def answer(x, _p):
        value = Number(value=-x.value)
        return (
            Skipped(output=value, reason="nothing here")
            if kind is Skipped
            else Fallback(result=value, reason="another")
        )

    method = chain(answer)
    inputs = {"x": X, "y": Y}
    found = Graph((method,)).evaluate(["c"], inputs, {})["c"]
    assert (found.output.value, ran.names) == (-3.0, ["c.scaled"])
    assert (found.state == "skipped", found.fallback) == (
        kind is Skipped,
        "" if kind is Skipped else "another",
    )
    assert method.run(X, Y, ChainParams(), SILENT) == answer(X, None)


def test_an_early_answer_of_a_node_is_the_value_of_the_chain(chain, ran):
    method = chain(lambda x, _p: EarlyAnswer(output=Number(value=-x.value)))
    inputs = {"x": X, "y": Y}
    graph = Graph((method,))
    for state in ("computed", "cached"):
        found = graph.evaluate(["c"], inputs, {})["c"]
        assert (found.output.value, found.state, ran.names) == (-3.0, state, ["c.scaled"])
    assert method.run(X, Y, ChainParams(), SILENT).value == -3.0


@given(x=st.floats(-1e3, 1e3), scale=st.floats(-10, 10), shift=st.floats(-10, 10))
def test_a_chain_run_by_itself_equals_its_nodes_in_the_graph(x, scale, shift):
    nodes = (
        Method(
            stage="c.a",
            name="a",
            title="a",
            run=lambda x, p, _: Number(value=x.value * p.scale),
            params=ChainParams,
            reads=("x",),
        ),
        Method(
            stage="c.b",
            name="b",
            title="b",
            run=lambda a, p, _: Number(value=a.value + p.shift),
            params=ChainParams,
            reads=("c.a",),
        ),
    )
    method = Method(
        stage="c",
        name="c",
        title="c",
        run=chain_nodes(nodes, ("x",)),
        params=ChainParams,
        reads=("x",),
        nodes=nodes,
    )
    params = ChainParams(scale=scale, shift=shift)
    assert Graph((method,)).evaluate(["c"], {"x": Number(value=x)}, {"c": params})[
        "c"
    ].output == method.run(Number(value=x), params, SILENT)
