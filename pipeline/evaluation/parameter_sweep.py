"""Two parameters tried against each other on one frame: the error and the time of every pair of values."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from pipeline.base.errors import SettingProblem, TouchError
from pipeline.base.params import Value, list_settings, replace_value
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.cache import Cache
from pipeline.engine.graph import Graph, Method, StageResult
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.preview import Preview
from pipeline.previews.tile import Tile
from pipeline.stages.stage import PreviewContext
from pipeline.translation.translate import Translation

_CACHE_BYTES = 64 * 1024 * 1024  # what does not depend on the two parameters is worked out once
_MOST_VALUES = 12

MethodParams = Mapping[str, object]  # parameters of methods by key


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepAxis:
    """One parameter of a method and the values to try."""

    key: str  # of the method, "slot/name"
    name: str
    values: tuple[Value, ...]

    @property
    def qualified_name(self) -> str:
        """As the command line calls the parameter."""
        return f"{self.key.partition('/')[0]}.{self.name}"

    def apply_value(self, given: MethodParams, method: Method, value: Value) -> dict[str, object]:
        """The parameters with this value."""
        return {**given, self.key: replace_value(given.get(self.key, method.params()), self.name, value)}


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """What is swept: columns over rows, and the figure that judges."""

    across: SweepAxis
    down: SweepAxis
    metric: str  # "slot.name"; "" = only time

    @property
    def run_order(self) -> tuple[tuple[int, int], ...]:
        """(row, col) of all cells, corners first, so that one may stop early."""
        rows, cols = len(self.down.values), len(self.across.values)
        cells = list(product(range(rows), range(cols)))
        corners = {(r, c) for r in (0, rows - 1) for c in (0, cols - 1)}
        return tuple(sorted(cells, key=lambda cell: (cell not in corners, cell)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepCell:
    """One pair of values, tried."""

    row: int
    col: int
    error: float  # NaN = not known of this frame
    ms: float  # of all that the slot rests on, worked out afresh
    preview: Preview | None
    problem: str = ""


def find_method(methods: Sequence[Method], key: str) -> Method:
    """The method that is swept; raises SettingProblem where another fills its slot by now."""
    found = next((method for method in methods if method.key == key), None)
    if found is None:
        slot, _, name = key.partition("/")
        raise SettingProblem(f"{slot} is not filled by {name!r} for this source; choose the parameters to sweep again")
    return found


def parse_axis(params: object, method: Method, name: str, words: str) -> SweepAxis:
    """The values that somebody typed, commas between them; raises SettingProblem with what is wrong."""
    parts = [part.strip() for part in words.split(",") if part.strip()]
    if not 1 <= len(parts) <= _MOST_VALUES:
        raise SettingProblem(f"give one to {_MOST_VALUES} values of {name}, with commas between them")
    values = [list_settings(replace_value(params, name, part))[name][0] for part in parts]
    return SweepAxis(key=method.key, name=name, values=tuple(dict.fromkeys(values)))


def sweep_grid(
    translation: Translation, frame: int, given: MethodParams, display: DisplayParams, plan: SweepPlan,
    *, hand_over: Callable[[SweepCell], object] = lambda _: None, progress: Progress = SILENT,
) -> tuple[SweepCell, ...]:  # fmt: skip
    """Work the cells out one by one, corners first, handing each over. Raises TouchError, Cancelled."""
    if (plan.across.key, plan.across.name) == (plan.down.key, plan.down.name):
        raise SettingProblem("columns and rows are the same parameter; choose another for one of them")
    graph = translation.build_graph(like=Graph((), cache=Cache(_CACHE_BYTES)))
    times: dict[tuple[str, str], float] = {}
    across, down = (find_method(translation.methods, axis.key) for axis in (plan.across, plan.down))
    order, cells = plan.run_order, list[SweepCell]()
    for n, (row, col) in enumerate(order):
        now = plan.across.apply_value(given, across, plan.across.values[col])
        now = plan.down.apply_value(now, down, plan.down.values[row])
        part = SubProgress(progress, n / len(order), 1.0 / len(order), f"{n + 1} of {len(order)}")
        cells.append(_cell(translation, graph, now, display, plan.metric, frame, (row, col), times, part))
        hand_over(cells[-1])
    return tuple(cells)


def build_tiles(plan: SweepPlan, cells: Sequence[SweepCell]) -> tuple[Tile, ...]:
    """The cells row by row, with their figure; times are no figures, as another run has others."""
    across, down = plan.across, plan.down
    return tuple(
        Tile(
            title=f"{across.qualified_name}={across.values[cell.col]}, {down.qualified_name}={down.values[cell.row]}",
            metrics={plan.metric: cell.error} if math.isfinite(cell.error) else {}, preview=cell.preview,
            problem=cell.problem, starts_row=cell.col == 0,
        )
        for cell in sorted(cells, key=lambda cell: (cell.row, cell.col))
    )  # fmt: skip


def _cell(
    translation: Translation, graph: Graph, given: MethodParams, display: DisplayParams, figure: str, index: int,
    place: tuple[int, int], times: dict[tuple[str, str], float], progress: SubProgress,
) -> SweepCell:  # fmt: skip
    row, col = place
    last = figure.partition(".")[0] if figure else _last_but_pose(translation)
    try:
        params = {m.stage: given.get(m.key, m.params()) for m in translation.methods}
        results = graph.evaluate([last], translation.read_inputs(index), params, progress)
        error = translation.compute_metrics(results, index).get(figure, math.nan)
    except TouchError as problem:
        return SweepCell(row=row, col=col, error=math.nan, ms=math.nan, preview=None, problem=str(problem))
    for name, result in results.items():
        if result.state == "computed":
            times[(name, result.digest)] = result.ms
    ms = sum(times.get((name, result.digest), result.ms) for name, result in results.items())
    return SweepCell(row=row, col=col, error=error, ms=ms, preview=_picture(translation, display, results, last))


def _last_but_pose(translation: Translation) -> str:
    return next(name for name in reversed(translation.stages) if name != "pose")


def _picture(
    translation: Translation, display: DisplayParams, results: Mapping[str, StageResult], last: str
) -> Preview:
    seen = PreviewContext(
        outputs={name: r.output for name, r in results.items()}, source=translation.source,
        target=translation.target, mesh=translation.mesh, display=display,
    )  # fmt: skip
    return translation.catalogue.stage(last).make_preview(results[last].output, seen)
