"""`tactoscope ...`: the headless commands, and the window."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from pipeline.base.errors import SettingProblem
from pipeline.cli.main import build_app, run_app
from pipeline.cli.translation_options import DEFAULT_OPTIONS, RecordingPath, TargetName, TranslationOptions

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")


def main() -> None:
    """Entry of the `tactoscope` script."""
    app = build_app()
    app.command(view)
    sys.exit(run_app(app))


def view(
    recording: RecordingPath | None = None,
    *,
    target: TargetName = "",
    opening: TranslationOptions = DEFAULT_OPTIONS,
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
    from app.session.sample import SAMPLE_RECORDING

    nothing = recording is None and not target and opening == DEFAULT_OPTIONS
    request = None if nothing else opening.build_request(recording or SAMPLE_RECORDING, target)
    return open_window(request, frame=frame, tour=tour)
