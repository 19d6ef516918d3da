"""What *Compare* shows, as a command that makes the same pictures and numbers."""

from __future__ import annotations

import os
import shlex
from dataclasses import replace
from pathlib import Path

from app.session.compared import LAST_SLOT
from app.session.state import Session
from app.work.opening import request_of
from pipeline.base.params import settings
from pipeline.reporting.asked import opening, settings_of


def compare_command(session: Session, last_slot: str, target: str, out: Path) -> str:
    """`tactoscope compare ...` for the tab in front; `last_slot` and `target` are those of what is open."""
    words = ["tactoscope", "compare", *opened_words(session, target), "--frame", str(session.frame)]
    chosen = session.compared
    if chosen.tab == "methods":
        words += ["--order", chosen.order]
    elif chosen.tab == "seeds":
        words += ["--seeds", str(chosen.seeds)]
    elif session.held is not None:
        words += ["--slot", last_slot if chosen.slot == LAST_SLOT else chosen.slot or "all"]
        words += ["--beside", shlex.join(opened_words(session.held, target))]
    display = [word for line in settings_of({"display": session.display}) for word in ("--set", line)]
    return shlex.join([*words, *display, "--out", os.fspath(out.absolute())])


def opened_words(session: Session, target: str) -> list[str]:
    """What is open, with every parameter that was changed, of methods that fill no slot at present too."""
    request = replace(request_of(session), offsets=session.offsets, target=session.target or target)
    given = {key: params for key, params in session.params.items() if key != "display" and settings(params)}
    return [*opening(request), *(word for line in settings_of(given) for word in ("--set", line))]
