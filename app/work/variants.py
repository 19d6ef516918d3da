"""Variants of a session: their parameters, and the commands that make the same comparisons."""

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from app.session.layout import LAST_STAGE
from app.session.state import Session
from app.work.evaluator import Evaluator
from app.work.jobs import JobReporter
from app.work.requests import make_request
from pipeline.base.params import Setting, Value, list_settings
from pipeline.engine.graph import Method
from pipeline.evaluation.parameter_sweep import SweepPlan
from pipeline.evaluation.variants import Variant
from pipeline.reporting.export_request import format_options, format_settings

_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # suggested values as multiples of the current one
# Parameters to sweep by default, the most effective first.
_EFFECTIVE_PARAMETERS = "guidance", "steps", "certainty", "pressure_share", "smoothing_px", "grazing_deg"

SweepableParameter = tuple[str, str, str, Value, Setting]  # method key, parameter, stage.parameter, value, setting


def open_variant(label: str, evaluator: Evaluator, session: Session, report: JobReporter) -> tuple[Variant, int]:
    """A session's variant and its frame; raises TouchError."""
    translation, frame = evaluator.open_frame(session, report)
    return Variant(label=label, translation=translation, params=session.params), frame


def list_sweepable_parameters(
    session: Session, methods: Sequence[Method], sensor_kinds: Mapping[str, str] | None = None
) -> list[SweepableParameter]:
    """Parameters with more than one possible value; `sensor_kinds` is method key -> kind of sensor, where known."""
    kinds = sensor_kinds or {}
    return [
        (method.key, name, f"{method.stage}.{name}", value, setting)
        for method in methods
        for name, (value, setting) in list_settings(session.get_params(method)).items()
        if (not isinstance(value, str) or setting.choices) and setting.applies_to(kinds.get(method.key, ""))
    ]


def choose_default_axes(parameters: Sequence[SweepableParameter]) -> tuple[int, int]:
    """Indices of the parameters to sweep by default: guidance and steps if the touch is sampled.

    Otherwise those that changed the error in contact most on touches of the sample when swept over their suggested
    values: the certainty that a network's contact needs; the pressure share that counts as contact on a gel and the
    smoothing of its slopes; the steepest surface that the target may observe. Otherwise the first numbers.
    """
    ranked = [i for name in _EFFECTIVE_PARAMETERS for i, parameter in enumerate(parameters) if parameter[1] == name]
    ranked += [i for i, p in enumerate(parameters) if isinstance(p[3], (int, float)) and i not in ranked]
    return (ranked[0], ranked[1]) if len(ranked) > 1 else (0, 0)


def suggest_values(value: Value, setting: Setting) -> tuple[Value, ...]:
    """Values to try: all of a few choices, those of the setting, or multiples of the current value in its limits."""
    if isinstance(value, bool):
        return (False, True)
    if setting.choices:
        return setting.choices
    if setting.sweep:
        return setting.sweep
    if isinstance(value, str):
        return (value,)
    base = value or (setting.step or 1.0)
    values = sorted({min(max(base * factor, setting.low), setting.high) for factor in _FACTORS} | {float(value)})
    return tuple(dict.fromkeys(round(v) for v in values)) if isinstance(value, int) else tuple(values)


def format_compare_command(
    session: Session, last_stage: str, target: str, out: Path, plan: SweepPlan | None = None
) -> str:
    """`tactoscope compare ...` for the current tab, or for a sweep; `last_stage` and `target` are the opened ones."""
    words = ["tactoscope", "compare", *_list_options(session, target), "--frame", str(session.frame)]
    settings = session.comparison
    if plan is not None:
        for option, axis in (("--across", plan.across), ("--down", plan.down)):
            words += [option, f"{axis.qualified_name}={','.join(str(value).lower() for value in axis.values)}"]
        words += ["--metric", plan.metric]
    elif settings.tab == "methods":
        words += ["--order", settings.order]
    elif settings.tab == "seeds":
        words += ["--seeds", str(settings.seeds)]
    elif session.variant is not None:
        words += ["--stage", last_stage if settings.stage == LAST_STAGE else settings.stage or "all"]
        words += ["--variant", shlex.join(_list_options(session.variant, target))]
    display = [word for line in format_settings({"display": session.display}) for word in ("--set", line)]
    return shlex.join([*words, *display, "--out", os.fspath(out.absolute())])


def _list_options(session: Session, target: str) -> list[str]:
    """What is open, with every changed parameter, also of methods that are not in use."""
    request = replace(make_request(session), offsets=session.offsets, target=session.target or target)
    params = {key: value for key, value in session.params.items() if key != "display" and list_settings(value)}
    return [*format_options(request), *(word for line in format_settings(params) for word in ("--set", line))]
