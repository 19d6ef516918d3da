"""Run time against error of the touch methods over denoising steps and guidance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.core.errors import SettingProblem
from pipeline.core.figures import make_figure, save_figure
from pipeline.core.params import list_settings
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.lab.evaluation.candidates import BASELINES
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
    known = [p for p in points if p.contact_error_mm is not None]
    methods = [p for p in known if p.row.candidate not in BASELINES]
    for source, target in dict.fromkeys((p.row.source, p.row.target) for p in methods):
        figure = make_figure(figsize=(8.4, 5.2), dpi=120, layout="constrained")
        axes: Any = figure.add_subplot()
        curves: dict[str, list[SweepPoint]] = {}
        for p in methods:
            if (p.row.source, p.row.target) == (source, target):
                curves.setdefault(f"{p.row.candidate} {p.parameter}".strip(), []).append(p)
        for label, curve in curves.items():
            errors = [p.contact_error_mm for p in curve]
            axes.plot([p.row.ms for p in curve], errors, "o-", label=label)
            for p in curve if curve[0].parameter else ():
                axes.annotate(f"{p.value:g}", (p.row.ms, p.contact_error_mm), fontsize=7)
        for p in known:
            if p.row.candidate in BASELINES and p.row.target == target:
                axes.axhline(p.contact_error_mm, color="grey", ls=":", label=p.row.title)
        titles = [load_sensor(name).title for name in (source, target)]
        axes.set(
            xscale="log",
            yscale="log",
            title=" to ".join(titles),
            xlabel="time of a touch, ms",
            ylabel="error in contact, mm",
        )
        axes.legend(fontsize=8)
        files.append(folder / f"{source}_to_{target}.png")
        save_figure(figure, files[-1], "the plot")
    return files
