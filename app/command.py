"""`tactoscope ...`: the headless commands, and the window."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal

from pipeline.base.errors import SettingProblem
from pipeline.cli.main import build, run

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")


def main() -> None:
    """Entry of the `tactoscope` script."""
    app = build()
    app.command(view)
    sys.exit(run(app))


def view(
    recording: Path | None = None,
    *,
    target: str = "",
    sensor: str = "",
    reference: Path | None = None,
    calibration: Path | None = None,
    mesh: Path | None = None,
    mesh_unit: Literal["auto", "mm", "cm", "m"] = "auto",
    alignment: Path | None = None,
    frame: int | None = None,
    tour: Path | None = None,
) -> int:
    """Open the window, on the sample recording if none is given.

    Parameters
    ----------
    recording
        File or folder of any known format.
    target
        Sensor to translate to.
    sensor
        The sensor that made the recording, where the file does not say.
    reference
        Image of the untouched sensor, where the recording holds none.
    calibration
        Look-up made by `tactoscope calibrate balls`.
    mesh
        The touched object's mesh, for its pose.
    mesh_unit
        Unit of that mesh.
    alignment
        How the two sensors stand to each other, a .toml as `tactoscope align refine` writes it.
    frame
        Frame to begin with.
    tour
        Step through the recording by itself, write the window's picture and every stage into this folder, and close.
    """
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in _SCREENS):
        raise SettingProblem("there is no display to show a window on; run it under xvfb-run, or use translate")
    from app.main import open_window

    return open_window(
        recording, target=target, source=sensor, reference=reference, calibration=calibration, mesh=mesh,
        mesh_unit=mesh_unit, alignment=alignment,
        frame=frame, tour=tour,
    )  # fmt: skip
