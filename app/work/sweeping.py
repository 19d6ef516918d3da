"""What a session offers to sweep, and the sweep itself on a translation of its own."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from app.session.state import Session
from app.work.compared_command import opened_words
from app.work.jobs import Report
from app.work.opening import request_of
from pipeline.base.params import Setting, Value, settings
from pipeline.engine.graph import Method
from pipeline.reporting.asked import settings_of
from pipeline.scoring import two_parameters
from pipeline.scoring.two_parameters import Axis, Plan
from pipeline.translation.translate import open_translation

_USUAL = (0.25, 0.5, 1.0, 2.0, 4.0)  # times the present value
_MATTERS = "guidance", "steps", "certainty", "pressure_share", "smoothing_px", "grazing_deg"  # most first

Offer = tuple[str, str, str, Value, Setting]  # method's key, parameter, words, value, how it is set


def offered(session: Session, methods: Sequence[Method], kinds: Mapping[str, str] | None = None) -> list[Offer]:
    """All that can be swept; `kinds`: a method's key -> the kind of sensor that it looks at, left out = not known."""
    known = kinds or {}
    return [
        (method.key, name, f"{method.slot}.{name}", value, told)
        for method in methods
        for name, (value, told) in settings(session.params_of(method)).items()
        if (not isinstance(value, str) or told.choices) and told.says(known.get(method.key, ""))
    ]


def first_two(offers: Sequence[Offer]) -> tuple[int, int]:
    """Which of what is offered a sweep begins with: guidance and steps where the touch is sampled.

    Else what moved the error in contact most on touches of the sample, each parameter swept over its usual values: of
    a network's depth how certain its contact must be, of a gel's which share of the pressure counts as contact and how
    much its slopes are smoothed, then how steep a surface the target may see; else the first numbers.
    """
    wanted = [i for word in _MATTERS for i, offer in enumerate(offers) if offer[1] == word]
    numbers = [i for i, offer in enumerate(offers) if isinstance(offer[3], (int, float)) and i not in wanted]
    ranked = [*wanted, *numbers]
    return (ranked[0], ranked[1]) if len(ranked) > 1 else (0, 0)


def usual_values(value: Value, told: Setting) -> tuple[Value, ...]:
    """What to try where nobody says: all of a few, else around the present value within its limits."""
    if isinstance(value, bool):
        return (False, True)
    if told.choices:
        return told.choices
    if isinstance(value, str):
        return (value,)
    base = value or (told.step or 1.0)
    tried = sorted({min(max(base * times, told.low), told.high) for times in _USUAL} | {float(value)})
    return tuple(dict.fromkeys(round(v) for v in tried)) if isinstance(value, int) else tuple(tried)


def swept(session: Session, plan: Plan, report: Report) -> int:
    """Work the cells out one by one, handing each over; how many there were. Raises TouchError, Cancelled."""
    with closing(open_translation(request_of(session))) as opened:
        translation = replace(opened, alignment=session.offsets.applied(opened.alignment))
        frame = min(max(0, session.frame), translation.n_frames - 1)
        cells = two_parameters.swept(
            translation, frame, session.params, session.display, plan, hand_over=report.hand_over, progress=report
        )
    return len(cells)


def sweep_command(session: Session, plan: Plan, target: str, out: Path) -> str:
    """`tactoscope compare ...` that tries the same pairs of values."""
    words = ["tactoscope", "compare", *opened_words(session, target), "--frame", str(session.frame)]
    words += ["--across", _typed(plan.across), "--down", _typed(plan.down), "--figure", plan.figure]
    display = [word for line in settings_of({"display": session.display}) for word in ("--set", line)]
    return shlex.join([*words, *display, "--out", os.fspath(out.absolute())])


def _typed(axis: Axis) -> str:
    return f"{axis.called}={','.join(str(value).lower() for value in axis.values)}"
