"""The `tactoscope` command: the headless commands, and `view`, which opens the window."""

import os
import sys
from pathlib import Path

from pipeline.cli.main import build_app, run_app
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    RecordingPath,
    TargetName,
    TranslationOptions,
)
from pipeline.core.errors import SettingProblem

_DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")


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
    """Open the window.

    Args:
        frame: First frame to show.
        tour: Show every frame, write a screenshot and every stage to this folder, and close.
    """
    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in _DISPLAY_VARIABLES
    ):
        raise SettingProblem(
            "no display for the window; run it under xvfb-run, or use `tactoscope translate`"
        )
    from app.main import open_window
    from app.session.sample import SAMPLE_RECORDING

    is_default = recording is None and not target and opening == DEFAULT_OPTIONS
    request = None if is_default else opening.build_request(recording or SAMPLE_RECORDING, target)
    return open_window(request, frame=frame, tour=tour)
