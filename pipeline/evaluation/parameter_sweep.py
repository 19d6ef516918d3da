"""Pairs of values of two parameters on one frame: the error and the time of each pair."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

from pipeline.base.errors import SettingProblem
from pipeline.base.params import Value, list_settings, replace_value
from pipeline.base.progress import SILENT, Progress
from pipeline.engine.graph import Method
from pipeline.evaluation.comparison_tiles import Comparison
from pipeline.evaluation.variants import MethodParams, Variant, VariantResult, VariantRunner
from pipeline.previews.display_params import DisplayParams
from pipeline.previews.preview import Preview
from pipeline.previews.tile import Tile
from pipeline.translation.translate import Translation

_MAX_VALUES = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepAxis:
    """One parameter of a method and the values to try."""

    key: str  # of the method, "stage/name"
    name: str
    values: tuple[Value, ...]

    @property
    def qualified_name(self) -> str:
        """The parameter as `stage.parameter`."""
        return f"{self.key.partition('/')[0]}.{self.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """The parameters of columns and rows, and the metric."""

    across: SweepAxis
    down: SweepAxis
    metric: str  # "stage.name"; "" = time only

    @property
    def run_order(self) -> tuple[tuple[int, int], ...]:
        """(row, col) of all cells, corners first, so that one can stop early."""
        rows, cols = len(self.down.values), len(self.across.values)
        corners = {(r, c) for r in (0, rows - 1) for c in (0, cols - 1)}
        return tuple(sorted(product(range(rows), range(cols)), key=lambda cell: (cell not in corners, cell)))

    def build_variant(self, base: Variant, row: int, col: int) -> Variant:
        """The base with the values of one cell; raises SettingProblem if another method is in use by now."""
        variant = base
        for axis, index in ((self.across, col), (self.down, row)):
            variant = variant.with_value(find_method(base.translation.methods, axis.key), axis.name, axis.values[index])
        return variant


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepCell:
    """Result of one pair of values."""

    row: int
    col: int
    error: float  # NaN = not known for this frame
    ms: float  # of all stages up to the metric's, as when computed
    preview: Preview | None
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class GridComparison(Comparison):
    """Tiles of a parameter sweep, with their cells in run order."""

    cells: tuple[SweepCell, ...] = ()


def format_value(value: object) -> str:
    """A parameter value as it is typed."""
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


def find_method(methods: Sequence[Method], key: str) -> Method:
    """The method of that key; raises SettingProblem if its stage uses another method by now."""
    found = next((method for method in methods if method.key == key), None)
    if found is None:
        stage, _, name = key.partition("/")
        raise SettingProblem(f"{stage} does not use {name!r} for this source; choose the parameters to sweep again")
    return found


def parse_axis(params: object, method: Method, name: str, text: str) -> SweepAxis:
    """The axis of comma-separated values; raises SettingProblem."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not 1 <= len(parts) <= _MAX_VALUES:
        raise SettingProblem(f"give one to {_MAX_VALUES} values of {name}, comma-separated")
    values = [list_settings(replace_value(params, name, part))[name][0] for part in parts]
    return SweepAxis(key=method.key, name=name, values=tuple(dict.fromkeys(values)))


def compare_grid(
    runner: VariantRunner, translation: Translation, frame: int, params: MethodParams, display: DisplayParams,
    plan: SweepPlan, progress: Progress = SILENT,
) -> Iterator[GridComparison]:  # fmt: skip
    """The cells so far, corners first, one more each time. Raises TouchError, Cancelled."""
    if plan.across.qualified_name == plan.down.qualified_name:
        raise SettingProblem("columns and rows are the same parameter; choose another for one of them")
    base = Variant(label="", translation=translation, params=params)
    variants = [plan.build_variant(base, row, col) for row, col in plan.run_order]
    stage = plan.metric.partition(".")[0] or next(name for name in reversed(translation.stages) if name != "pose")
    cells: list[SweepCell] = []
    for (row, col), result in zip(plan.run_order, runner.evaluate_all(variants, frame, [stage], progress), strict=True):
        cells.append(_make_cell(result, row, col, stage, plan.metric, display))
        names = f"{plan.across.qualified_name} by {plan.down.qualified_name}"
        summary = f"frame {frame}: {names}, {len(cells)} pairs"
        yield GridComparison(tiles=build_tiles(plan, cells), summary=summary, cells=tuple(cells))


def build_tiles(plan: SweepPlan, cells: Sequence[SweepCell]) -> tuple[Tile, ...]:
    """The cells row by row with their metric; without times, which differ from run to run."""
    across, down = plan.across, plan.down
    return tuple(
        Tile(
            title=f"{across.qualified_name}={across.values[cell.col]}, {down.qualified_name}={down.values[cell.row]}",
            metrics={plan.metric: cell.error} if math.isfinite(cell.error) else {}, preview=cell.preview,
            problem=cell.problem, starts_row=cell.col == 0,
        )
        for cell in sorted(cells, key=lambda cell: (cell.row, cell.col))
    )  # fmt: skip


def _make_cell(result: VariantResult, row: int, col: int, stage: str, metric: str, display: DisplayParams) -> SweepCell:
    if result.problem:
        return SweepCell(row=row, col=col, error=math.nan, ms=math.nan, preview=None, problem=result.problem)
    error = result.compute_metrics().get(metric, math.nan)
    return SweepCell(row=row, col=col, error=error, ms=result.ms, preview=result.make_preview(stage, display))
