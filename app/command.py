"""`tactoscope ...`: the headless commands, and the window."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.cli.main import build, run
from pipeline.cli.opening_options import NOTHING_ELSE, Opening, Recorded, Target

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")


def main() -> None:
    """Entry of the `tactoscope` script."""
    app = build()
    app.command(view)
    sys.exit(run(app))


def view(
    recording: Recorded | None = None,
    *,
    target: Target = "",
    opening: Opening = NOTHING_ELSE,
    frame: int | None = None,
    tour: Path | None = None,
) -> int:
    """Open the window, on the sample recording if none is given.

    Parameters
    ----------
    frame
        Frame to begin with.
    tour
        Step through the recording by itself, write the window's picture and every slot into this folder, and close.
    """
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in _SCREENS):
        raise SettingProblem("there is no display to show a window on; run it under xvfb-run, or use translate")
    from app.main import open_window
    from app.session.sample import SAMPLE

    nothing = recording is None and not target and opening == NOTHING_ELSE
    request = None if nothing else opening.request(recording or SAMPLE, target)
    return open_window(request, frame=frame, tour=tour)
