"""One frame on a grid: columns and rows each try methods, weights, seeds or values of a
parameter.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, product
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Floats, Mask
from pipeline.core.errors import SettingProblem, TouchError
from pipeline.core.frozen import frozen
from pipeline.core.params import Value, list_settings, replace_value
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.results import DepthMap
from pipeline.lab.evaluation.comparison_tiles import Comparison
from pipeline.lab.evaluation.variants import (
    MethodParams,
    Variant,
    VariantResult,
    VariantRunner,
    choose_methods,
)
from pipeline.translation.translate import Translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import Preview, Tile

# what an axis tries besides parameters; a seed is one of these
METHOD = "method"
WEIGHTS = "weights"
SEED = "seed"
_MAX_VALUES = 12
_TOUCH_DEPTH = "touch_depth"  # whose spread over seeds is measured
_USAGE = "an axis is stage.parameter=value,value, stage.method=name,name or stage.weights=file,file"


@frozen
class GridAxis:
    """What is tried along one axis of a grid."""

    stage: str
    name: str  # a parameter of the stage's method, METHOD or WEIGHTS
    values: tuple[Value, ...]

    @property
    def title(self) -> str:
        """The axis as it is typed, without its values."""
        return f"{self.stage}.{self.name}"

    def vary(self, variant: Variant, index: int) -> Variant:
        """The variant with one value of this axis; raises SettingProblem."""
        value = self.values[index]
        if self.name not in (METHOD, WEIGHTS):
            method = variant.translation.get_method(self.stage)
            return variant.with_value(method, self.name, value)
        methods = {self.stage: str(value)} if self.name == METHOD else {}
        weights = {self.stage: Path(str(value))} if self.name == WEIGHTS else {}
        translation = choose_methods(variant.translation, methods, weights)
        return replace(variant, translation=translation)


@frozen
class GridPlan:
    """The axes of columns and rows, and the metric."""

    across: GridAxis
    down: GridAxis | None = None  # None = one row
    metric: str  # "stage.name"; "" = time only

    @property
    def axes(self) -> tuple[GridAxis, ...]:
        """Columns, then rows if there are several."""
        return (self.across,) if self.down is None else (self.across, self.down)

    @property
    def run_order(self) -> tuple[tuple[int, int], ...]:
        """(row, col) of all cells, corners first, so that one can stop early."""
        rows = 1 if self.down is None else len(self.down.values)
        cols = len(self.across.values)
        corners = {(r, c) for r in (0, rows - 1) for c in (0, cols - 1)}
        return tuple(
            sorted(product(range(rows), range(cols)), key=lambda cell: (cell not in corners, cell))
        )

    def build_variant(self, base: Variant, row: int, col: int) -> Variant:
        """The base with the values of one cell.

        Raises SettingProblem for a parameter that its method lacks.
        """
        variant = base
        # The method comes first: parameters are those of the method in use.
        for axis, index in sorted(
            zip(self.axes, (col, row), strict=False), key=lambda pair: pair[0].name != METHOD
        ):
            variant = axis.vary(variant, index)
        return variant


@frozen
class GridCell:
    """Result of one cell."""

    row: int
    col: int
    error: float = math.nan  # NaN = not known for this frame
    ms: float = math.nan  # of all stages up to the metric's, as when computed
    preview: Preview | None = None
    problem: str = ""


@frozen
class GridComparison(Comparison):
    """Tiles of a grid, with their cells in run order."""

    cells: tuple[GridCell, ...] = ()


def format_value(value: object) -> str:
    """A value as it is typed."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def parse_axis(base: Variant, text: str) -> GridAxis:
    """Read `stage.name=value,value`, checked against the method in use; raises SettingProblem."""
    title, _, listed = text.partition("=")
    stage, _, name = title.strip().partition(".")
    if stage not in base.translation.stages or not name:
        raise SettingProblem(f"{_USAGE}, with a stage of this route; got {text!r}")
    parts = [part.strip() for part in listed.split(",") if part.strip()]
    if not 1 <= len(parts) <= _MAX_VALUES:
        raise SettingProblem(f"give one to {_MAX_VALUES} values of {name}, comma-separated")
    values: list[Value] = [*parts]
    if name == METHOD:
        for part in parts:
            base.translation.catalogue.method(stage, part)
    elif name != WEIGHTS:
        params = base.stage_params[stage]
        values = [list_settings(replace_value(params, name, part))[name][0] for part in parts]
    return GridAxis(stage=stage, name=name, values=tuple(dict.fromkeys(values)))


def compare_grid(
    runner: VariantRunner,
    translation: Translation,
    frame: int,
    params: MethodParams,
    display: DisplayParams,
    plan: GridPlan,
    progress: Progress = SILENT,
) -> Iterator[GridComparison]:
    """The cells so far, corners first, one more each time.

    One that fails has its problem. Raises Cancelled.

    Where an axis is a seed, the last summary says how much the touches differ, and whether that
    explains their error.
    """
    if len({axis.title for axis in plan.axes}) < len(plan.axes):
        raise SettingProblem("columns and rows try the same; choose another for one of them")
    base = Variant(label="", translation=translation, params=params)
    stage = plan.metric.partition(".")[0] or next(
        name for name in reversed(translation.stages) if name != "pose"
    )
    cells: list[GridCell] = []
    touches: dict[tuple[int, int], DepthMap] = {}
    names = " by ".join(axis.title for axis in plan.axes)
    n = len(plan.run_order)
    for number, (row, col) in enumerate(plan.run_order, start=1):
        part = SubProgress(progress, (number - 1) / n, 1.0 / n, f"{number} of {n}")
        part.step(0.0, "")
        try:
            variant = plan.build_variant(base, row, col)
            result = runner.evaluate(variant, frame, [stage], part, timed=True)
            cells.append(_make_cell(result, plan, row, col, stage, display))
            touch = result.results.get(_TOUCH_DEPTH)
            if touch is not None and not cells[-1].problem and isinstance(touch.output, DepthMap):
                touches[row, col] = touch.output
        except TouchError as error:
            cells.append(GridCell(row=row, col=col, problem=str(error)))
        facts = [f"frame {frame}: {names}, {number} of {n}"]
        if number == n:
            truth = translation.read_true_outputs(frame).get(_TOUCH_DEPTH)
            facts += _describe_spread(plan, touches, truth)
        yield GridComparison(
            tiles=build_tiles(plan, cells), summary="; ".join(facts), cells=tuple(cells)
        )


def build_tiles(plan: GridPlan, cells: Sequence[GridCell]) -> tuple[Tile, ...]:
    """The cells row by row with their metric; without times, which differ from run to run."""
    return tuple(
        Tile(
            title=", ".join(
                f"{axis.title}={format_value(axis.values[index])}"
                for axis, index in zip(plan.axes, (cell.col, cell.row), strict=False)
            ),
            metrics={plan.metric: cell.error} if math.isfinite(cell.error) else {},
            preview=cell.preview,
            problem=cell.problem,
            starts_row=cell.col == 0,
        )
        for cell in sorted(cells, key=lambda cell: (cell.row, cell.col))
    )


def _make_cell(
    result: VariantResult, plan: GridPlan, row: int, col: int, stage: str, display: DisplayParams
) -> GridCell:
    """The cell of a result; a method or weights in whose place another method answered are a
    problem.
    """
    chosen = [axis.stage for axis in plan.axes if axis.name in (METHOD, WEIGHTS)]
    problem = next(
        (r.fallback for name, r in result.results.items() if name in chosen and r.fallback), ""
    )
    if problem:
        return GridCell(row=row, col=col, problem=problem)
    error = result.compute_metrics().get(plan.metric, math.nan)
    return GridCell(
        row=row, col=col, error=error, ms=result.ms, preview=result.make_preview(stage, display)
    )


def _describe_spread(
    plan: GridPlan, touches: Mapping[tuple[int, int], DepthMap], truth: object
) -> list[str]:
    """Return a sentence per line of seeds; [] without an axis of seeds."""
    seeds = next((k for k, axis in enumerate(plan.axes) if axis.name == SEED), None)
    if seeds is None:
        return []
    others = [axis for axis in plan.axes if axis.name != SEED]
    known = truth if isinstance(truth, DepthMap) else None
    texts: list[str] = []
    for line, keys in groupby(
        sorted(touches, key=lambda key: key[seeds]), key=lambda key: key[seeds]
    ):
        samples = [touches[key].indentation_mm for key in keys]
        if len(samples) < 2:
            continue
        spread = measure_spread(
            samples,
            None if known is None else known.indentation_mm,
            None if known is None else known.contact,
        )
        words = [f"{axis.title}={format_value(axis.values[line])}: " for axis in others]
        texts.append("".join((*words, spread.summary)))
    return texts


@frozen
class Spread:
    """How samples of one membrane differ, in mm (rms in true contact, else everywhere).

    The standard deviation of a calibrated sampler equals its error. If the error is larger, more
    samples do not help.
    """

    n_samples: int
    std_mm: float  # standard deviation of one sample about the mean
    bias_mm: float  # of the mean; NaN if unknown

    @property
    def summary(self) -> str:
        """Error of a sample, and how much of its square is variance or bias."""
        if self.std_mm == 0.0:
            return "every seed gives the same touch (a network samples from 2 denoising steps on)"
        spread = f"{self.n_samples} samples have a standard deviation of {self.std_mm:.3g} mm"
        if not math.isfinite(self.bias_mm):
            return f"{spread}; their error is not known"
        # The mean of a few samples has a random error that is not bias.
        variance_sq = self.std_mm**2
        bias_sq = max(0.0, self.bias_mm**2 - variance_sq / self.n_samples)
        share = variance_sq / max(variance_sq + bias_sq, 1e-30)
        cause = "variance" if share > 0.5 else "bias, which more samples do not reduce"
        return (
            f"{spread} in contact and an error of {math.sqrt(variance_sq + bias_sq):.3g} mm (rms): "
            f"{max(share, 1.0 - share):.0%} of the square is {cause}"
        )


def measure_spread(
    samples_mm: Sequence[Floats], true_mm: Floats | None, contact: Mask | None
) -> Spread:
    """Measure the spread of two or more samples (rows, cols) in mm; `contact` is the true one."""
    stack = np.asarray(samples_mm, np.float64)
    mean_mm = stack.mean(axis=0)
    std_mm = stack.std(axis=0, ddof=1)
    shape = mean_mm.shape
    where = (
        contact
        if contact is not None and contact.shape == shape and contact.any()
        else np.ones(shape, np.bool_)
    )
    bias_mm = (
        mean_mm - true_mm
        if true_mm is not None and true_mm.shape == shape
        else np.full(shape, math.nan)
    )

    def compute_rms(values: Floats) -> float:
        inside = values[where & np.isfinite(values)]
        return math.sqrt(float((inside**2).mean())) if inside.size else math.nan

    return Spread(n_samples=len(stack), std_mm=compute_rms(std_mm), bias_mm=compute_rms(bias_mm))
