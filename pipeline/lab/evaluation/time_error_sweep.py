"""Run time against error of the touch methods over denoising steps and guidance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.core.errors import SettingProblem
from pipeline.core.figures import make_figure, save_figure
from pipeline.core.params import list_settings
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.lab.evaluation.paper_tables import EvaluationRequest, JobMapper, evaluate_tables
from pipeline.lab.evaluation.table_rows import TableRow
from pipeline.sensors.spec import load_sensor
from pipeline.translation.catalogue import BUILT_IN

SWEEP_VALUES: Mapping[str, tuple[float, ...]] = {
    "steps": (1, 2, 4, 8, 20, 50, 200),
    "guidance": (0.0, 1.0, 1.5, 2.54, 7.0, 15.0),
}
# guidance has no effect in one step
_FIXED: Mapping[str, tuple[str, ...]] = {"guidance": ("touch.steps=8",)}
_MARKS = {"steps": "o-", "guidance": "s"}  # no line: time hardly depends on guidance
_PREFIXES = {"guidance": "g "}  # of a value's label


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPoint:
    """A method with one parameter at one value; "" = defaults."""

    parameter: str
    value: float
    row: TableRow

    @property
    def contact_error_mm(self) -> float | None:
        """Error in the true contact, mm."""
        return self.row.metrics.get("error_mm", {}).get("contact")


def sweep_parameters(
    request: EvaluationRequest,
    parameters: Sequence[str],
    progress: Progress = SILENT,
    work: JobMapper | None = None,
) -> list[SweepPoint]:
    """Every touch method with defaults, and with each of its parameters at each value of
    `SWEEP_VALUES`.

    Guidance is swept at eight steps unless `request` sets them. Raises SettingProblem for an
    unknown parameter.
    """
    check_sweep_parameters(parameters)
    plain = replace(
        request,
        pose_methods=(),
        candidates=request.candidates
        or ("mean", *(m.name for m in BUILT_IN.stage("touch").methods)),
    )
    runs = _list_runs(plain, parameters)
    points: list[SweepPoint] = []
    for index, (name, value, one) in enumerate(runs):
        part = SubProgress(
            progress, index / len(runs), 1.0 / len(runs), f"{name} {value:g}" if name else ""
        )
        points += [
            SweepPoint(parameter=name, value=value, row=row)
            for row in evaluate_tables(one, part, work).rows
        ]
    return points


def check_sweep_parameters(parameters: Sequence[str]) -> None:
    """Raise SettingProblem for a parameter that cannot be swept."""
    for name in parameters:
        if name not in SWEEP_VALUES:
            raise SettingProblem(f"{name!r} cannot be swept; there are {', '.join(SWEEP_VALUES)}")


def _list_runs(
    plain: EvaluationRequest, parameters: Sequence[str]
) -> list[tuple[str, float, EvaluationRequest]]:
    """(parameter, value, request): all methods with defaults, then those that have the
    parameter.
    """
    runs: list[tuple[str, float, EvaluationRequest]] = [("", 0.0, plain)]
    for name in parameters:
        ranges = {
            method.name: list_settings(method.params())[name][1]
            for method in BUILT_IN.stage("touch").methods
            if method.name in plain.candidates and name in list_settings(method.params())
        }
        for value in SWEEP_VALUES[name]:
            methods = tuple(
                method for method, span in ranges.items() if span.low <= value <= span.high
            )
            if methods:
                settings = (*_FIXED.get(name, ()), *plain.settings, f"touch.{name}={value:g}")
                runs.append((name, value, replace(plain, candidates=methods, settings=settings)))
    return runs


def draw_sweep_plots(points: Sequence[SweepPoint], folder: Path) -> list[Path]:
    """One plot per direction, error in contact against time of a touch.

    Returns the files. Raises FileProblem.
    """
    files: list[Path] = []
    for source, target in dict.fromkeys(
        (p.row.source, p.row.target) for p in points if p.row.candidate != "mean"
    ):
        shown = [
            p
            for p in points
            if p.row.target == target and (p.row.source == source or p.row.candidate == "mean")
        ]
        path = folder / f"{source}_to_{target}.png"
        _draw_plot(shown, f"{load_sensor(source).title} to {load_sensor(target).title}", path)
        files.append(path)
    return files


def _draw_plot(points: Sequence[SweepPoint], title: str, path: Path) -> None:
    from matplotlib.ticker import FuncFormatter

    figure = make_figure(figsize=(8.4, 5.2), dpi=120, layout="constrained")
    axes: Any = figure.add_subplot()
    colours = {
        name: f"C{k}" for k, name in enumerate(dict.fromkeys(p.row.candidate for p in points))
    }
    for candidate, colour in colours.items():
        for parameter in dict.fromkeys(p.parameter for p in points if p.row.candidate == candidate):
            curve = [p for p in points if (p.row.candidate, p.parameter) == (candidate, parameter)]
            _draw_curve(axes, candidate, parameter, curve, colour)
    axes.set(
        xscale="log",
        yscale="log",
        title=title,
        xlabel="time of a touch, ms",
        ylabel="error in contact, mm",
    )
    for axis in (axes.xaxis, axes.yaxis):  # plain numbers, not powers of ten
        axis.set_major_formatter(FuncFormatter(_format_tick))
        axis.set_minor_formatter(FuncFormatter(_format_tick))
    axes.grid(visible=True, which="both", alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    save_figure(figure, path, "the plot")


def _format_tick(value: float, _: object) -> str:
    """Labels at 1, 2, 3 and 5 times a power of ten."""
    return f"{value:g}" if f"{value:e}"[0] in "1235" else ""


def _draw_curve(
    axes: Any, candidate: str, parameter: str, points: Sequence[SweepPoint], colour: str
) -> None:
    known = [
        (p.row.ms, p.contact_error_mm, p.value) for p in points if p.contact_error_mm is not None
    ]
    if candidate == "mean":
        for _, error, _ in known[:1]:
            axes.axhline(error, color=colour, ls=":", label="mean of other touches")
        return
    times, errors, values = ([row[k] for row in known] for k in range(3))
    label = f"{candidate}, {parameter}" if parameter else candidate
    axes.plot(
        times,
        errors,
        _MARKS.get(parameter, "*"),
        color=colour,
        label=label,
        ms=5 if parameter else 11,
    )
    for ms, error, value in zip(times, errors, values, strict=True) if parameter else ():
        below = parameter in _PREFIXES
        axes.annotate(
            f"{_PREFIXES.get(parameter, '')}{value:g}",
            (ms, error),
            textcoords="offset points",
            xytext=(3, -9 if below else 3),
            fontsize=7,
            color=colour,
        )
