"""Run time against error: what more steps of denoising, or more guidance, give for their time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.base.errors import SettingProblem
from pipeline.base.files import open_atomic
from pipeline.base.params import list_settings
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.evaluation.paper_tables import EvaluationRequest, JobMapper, evaluate_tables
from pipeline.evaluation.table_rows import TableRow
from pipeline.sensors.spec import load_sensor
from pipeline.translation.catalogue import BUILT_IN

SWEEP_VALUES: Mapping[str, tuple[float, ...]] = {
    "steps": (1, 2, 4, 8, 20, 50, 200), "guidance": (0.0, 1.0, 1.5, 2.54, 7.0, 15.0),
}  # fmt: skip
_AT: Mapping[str, tuple[str, ...]] = {"guidance": ("touch.steps=8",)}  # in one step guidance does nothing
_MARKS = {"steps": "o-", "guidance": "s"}  # whatever guidance there is takes about as long: a line would tell nothing
_SIGNS = {"guidance": "g "}  # before a value


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPoint:
    """A method with one parameter at one value; "" = as it comes."""

    parameter: str
    value: float
    row: TableRow

    @property
    def contact_error_mm(self) -> float | None:
        """Error where the target is touched."""
        return self.row.metrics.get("error_mm", {}).get("contact")


def sweep_parameters(
    wanted: EvaluationRequest, parameters: Sequence[str], progress: Progress = SILENT, work: JobMapper | None = None
) -> list[SweepPoint]:
    """Every touch method as it comes, and again with each of the parameters that it has at each of its values.

    Guidance is swept at eight steps unless `wanted` tells another number. Raises SettingProblem for a parameter that
    is not swept.
    """
    check_sweep_parameters(parameters)
    plain = replace(wanted, poses=(), candidates=wanted.candidates or ("mean", *_methods()))
    rounds = list(_rounds(plain, parameters))
    points: list[SweepPoint] = []
    for index, (name, value, one) in enumerate(rounds):
        part = SubProgress(progress, index / len(rounds), 1.0 / len(rounds), f"{name} {value:g}" if name else "")
        points += [SweepPoint(parameter=name, value=value, row=row) for row in evaluate_tables(one, part, work).rows]
    return points


def check_sweep_parameters(parameters: Sequence[str]) -> None:
    """Raise SettingProblem for a parameter that is not swept, before anything is worked out."""
    for name in parameters:
        if name not in SWEEP_VALUES:
            raise SettingProblem(f"{name!r} is not swept; there are {', '.join(SWEEP_VALUES)}")


def _methods() -> tuple[str, ...]:
    return tuple(method.name for method in BUILT_IN.stage("touch").methods)


def _rounds(plain: EvaluationRequest, parameters: Sequence[str]) -> Sequence[tuple[str, float, EvaluationRequest]]:
    """(parameter, value, what to evaluate): all methods as they come, then those that have the parameter."""
    rounds: list[tuple[str, float, EvaluationRequest]] = [("", 0.0, plain)]
    for name in parameters:
        able = {
            method.name: list_settings(method.params())[name][1]
            for method in BUILT_IN.stage("touch").methods
            if method.name in plain.candidates and name in list_settings(method.params())
        }
        for value in SWEEP_VALUES[name]:
            those = tuple(method for method, span in able.items() if span.low <= value <= span.high)
            if those:
                told = (*_AT.get(name, ()), *plain.settings, f"touch.{name}={value:g}")
                rounds.append((name, value, replace(plain, candidates=those, settings=told)))
    return rounds


def draw_sweep_plots(points: Sequence[SweepPoint], folder: Path) -> list[Path]:
    """One picture a direction: time of a touch across, error in contact up; raises FileProblem."""
    made: list[Path] = []
    for source, target in dict.fromkeys((p.row.source, p.row.target) for p in points if p.row.candidate != "mean"):
        those = [p for p in points if p.row.target == target and (p.row.source == source or p.row.candidate == "mean")]
        path = folder / f"{source}_to_{target}.png"
        _draw(those, f"{load_sensor(source).title} to {load_sensor(target).title}", path)
        made.append(path)
    return made


def _draw(points: Sequence[SweepPoint], title: str, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    figure = Figure(figsize=(8.4, 5.2), dpi=120, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    colours = {name: f"C{k}" for k, name in enumerate(dict.fromkeys(p.row.candidate for p in points))}
    for contender, colour in colours.items():
        for parameter in dict.fromkeys(p.parameter for p in points if p.row.candidate == contender):
            those = [p for p in points if (p.row.candidate, p.parameter) == (contender, parameter)]
            _curve(axes, contender, parameter, those, colour)
    axes.set(xscale="log", yscale="log", title=title, xlabel="time of a touch, ms", ylabel="error in contact, mm")
    for axis in (axes.xaxis, axes.yaxis):  # numbers, not powers of ten
        axis.set_major_formatter(FuncFormatter(_plain))
        axis.set_minor_formatter(FuncFormatter(_plain))
    axes.grid(visible=True, which="both", alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    with open_atomic(path, "the plot") as file:
        canvas.print_png(file)


def _plain(value: float, _: object) -> str:
    """1, 2, 3 and 5 of every power of ten."""
    return f"{value:g}" if f"{value:e}"[0] in "1235" else ""


def _curve(axes: Any, contender: str, parameter: str, points: Sequence[SweepPoint], colour: str) -> None:
    known = [(p.row.ms, p.contact_error_mm, p.value) for p in points if p.contact_error_mm is not None]
    if contender == "mean":
        for _, error, _ in known[:1]:
            axes.axhline(error, color=colour, ls=":", label="mean of other touches")
        return
    times, errors, values = ([row[k] for row in known] for k in range(3))
    label = f"{contender}, {parameter}" if parameter else contender
    axes.plot(times, errors, _MARKS.get(parameter, "*"), color=colour, label=label, ms=5 if parameter else 11)
    for ms, error, value in zip(times, errors, values, strict=True) if parameter else ():
        below = parameter in _SIGNS
        axes.annotate(
            f"{_SIGNS.get(parameter, '')}{value:g}", (ms, error), textcoords="offset points",
            xytext=(3, -9 if below else 3), fontsize=7, color=colour,
        )  # fmt: skip
