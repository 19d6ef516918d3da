"""What a session offers to sweep, and the sweep itself on a translation of its own."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from app.session.state import Session
from app.work.comparison_command import list_opening_arguments
from app.work.jobs import JobReporter
from app.work.requests import make_request
from pipeline.base.params import Setting, Value, list_settings
from pipeline.engine.graph import Method
from pipeline.evaluation import parameter_sweep
from pipeline.evaluation.parameter_sweep import SweepAxis, SweepPlan
from pipeline.reporting.export_request import format_settings
from pipeline.translation.translate import open_translation

_USUAL = (0.25, 0.5, 1.0, 2.0, 4.0)  # times the present value
_MATTERS = "guidance", "steps", "certainty", "pressure_share", "smoothing_px", "grazing_deg"  # most first

SweepableParameter = tuple[str, str, str, Value, Setting]  # method's key, parameter, words, value, how it is set


def list_sweepable_parameters(
    session: Session, methods: Sequence[Method], kinds: Mapping[str, str] | None = None
) -> list[SweepableParameter]:
    """All that can be swept; `kinds`: a method's key -> the kind of sensor that it looks at, left out = not known."""
    known = kinds or {}
    return [
        (method.key, name, f"{method.stage}.{name}", value, told)
        for method in methods
        for name, (value, told) in list_settings(session.get_params(method)).items()
        if (not isinstance(value, str) or told.choices) and told.applies_to(known.get(method.key, ""))
    ]


def choose_default_axes(offers: Sequence[SweepableParameter]) -> tuple[int, int]:
    """Which of what is offered a sweep begins with: guidance and steps where the touch is sampled.

    Else what moved the error in contact most on touches of the sample, each parameter swept over its usual values: of
    a network's depth how certain its contact must be, of a gel's which share of the pressure counts as contact and how
    much its slopes are smoothed, then how steep a surface the target may see; else the first numbers.
    """
    wanted = [i for word in _MATTERS for i, offer in enumerate(offers) if offer[1] == word]
    numbers = [i for i, offer in enumerate(offers) if isinstance(offer[3], (int, float)) and i not in wanted]
    ranked = [*wanted, *numbers]
    return (ranked[0], ranked[1]) if len(ranked) > 1 else (0, 0)


def suggest_values(value: Value, setting: Setting) -> tuple[Value, ...]:
    """What to try where nobody says: all of a few, else around the present value within its limits."""
    if isinstance(value, bool):
        return (False, True)
    if setting.choices:
        return setting.choices
    if isinstance(value, str):
        return (value,)
    base = value or (setting.step or 1.0)
    tried = sorted({min(max(base * times, setting.low), setting.high) for times in _USUAL} | {float(value)})
    return tuple(dict.fromkeys(round(v) for v in tried)) if isinstance(value, int) else tuple(tried)


def run_sweep(session: Session, plan: SweepPlan, report: JobReporter) -> int:
    """Work the cells out one by one, handing each over; how many there were. Raises TouchError, Cancelled."""
    with closing(open_translation(make_request(session))) as opened:
        translation = replace(opened, alignment=session.offsets.apply_to(opened.alignment))
        frame = min(max(0, session.frame), translation.n_frames - 1)
        cells = parameter_sweep.sweep_grid(
            translation, frame, session.params, session.display, plan, hand_over=report.deliver, progress=report
        )
    return len(cells)


def format_sweep_command(session: Session, plan: SweepPlan, target: str, out: Path) -> str:
    """`tactoscope compare ...` that tries the same pairs of values."""
    words = ["tactoscope", "compare", *list_opening_arguments(session, target), "--frame", str(session.frame)]
    words += ["--across", _typed(plan.across), "--down", _typed(plan.down), "--figure", plan.metric]
    display = [word for line in format_settings({"display": session.display}) for word in ("--set", line)]
    return shlex.join([*words, *display, "--out", os.fspath(out.absolute())])


def _typed(axis: SweepAxis) -> str:
    return f"{axis.qualified_name}={','.join(str(value).lower() for value in axis.values)}"
