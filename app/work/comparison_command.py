"""What *Compare* shows, as a command that makes the same pictures and numbers."""

from __future__ import annotations

import os
import shlex
from dataclasses import replace
from pathlib import Path

from app.session.comparison_settings import LAST_STAGE
from app.session.state import Session
from app.work.requests import make_request
from pipeline.base.params import list_settings
from pipeline.reporting.export_request import format_options, format_settings


def format_compare_command(session: Session, last_stage: str, target: str, out: Path) -> str:
    """`tactoscope compare ...` for the tab in front; `last_slot` and `target` are those of what is open."""
    words = ["tactoscope", "compare", *list_opening_arguments(session, target), "--frame", str(session.frame)]
    chosen = session.comparison
    if chosen.tab == "methods":
        words += ["--order", chosen.order]
    elif chosen.tab == "seeds":
        words += ["--seeds", str(chosen.seeds)]
    elif session.variant is not None:
        words += ["--stage", last_stage if chosen.stage == LAST_STAGE else chosen.stage or "all"]
        words += ["--variant", shlex.join(list_opening_arguments(session.variant, target))]
    display = [word for line in format_settings({"display": session.display}) for word in ("--set", line)]
    return shlex.join([*words, *display, "--out", os.fspath(out.absolute())])


def list_opening_arguments(session: Session, target: str) -> list[str]:
    """What is open, with every parameter that was changed, of methods that fill no slot at present too."""
    request = replace(make_request(session), offsets=session.offsets, target=session.target or target)
    given = {key: params for key, params in session.params.items() if key != "display" and list_settings(params)}
    return [*format_options(request), *(word for line in format_settings(given) for word in ("--set", line))]
