"""Export request: everything that one exported file depends on, so that it can be written as a
command too.
"""

import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from decimal import Decimal
from pathlib import Path
from typing import Literal

from pipeline.core.frozen import frozen
from pipeline.core.params import list_settings, replace_value
from pipeline.sensors.alignment import Offsets
from pipeline.translation.translate import Request
from pipeline.views.display_params import DisplayParams

# panes that are no stages: all of them side by side, the source frame, both sensors in 3D, and
SHEET = "sheet"
SOURCE = "source"
SCENE = "scene"
PRESENTATION = "presentation"  # source, both sensors in 3D, generated and recorded touch
PaneContent = Literal["computed", "truth", "difference"]
_DISPLAY = "display."
_OPTIONS = {  # field of a request -> option of the command line
    "source": "--sensor",
    "stream": "--stream",
    "reference": "--reference",
    "reference_frames": "--reference-frames",
    "calibration": "--calibration",
    "route": "--route",
    "mesh": "--mesh",
    "mesh_unit": "--mesh-unit",
    "depth_unit": "--depth-unit",
    "alignment": "--alignment",
}


@frozen
class ExportRequest:
    """One file to export; its suffix is the format."""

    request: Request
    settings: tuple[str, ...] = ()  # "stage.parameter=value", also "display.parameter=value"
    pane: str = SHEET  # a stage or one of the above; several for a section, comma-separated
    content: PaneContent = "computed"
    frame: int = 0
    frames: str = ""  # of a table or a video, for example "0,3-7"; "" = all
    section: tuple[float, ...] = ()  # x, y of start and end of a line in mm; () = none
    size_px: tuple[int, int] | None = None  # width and height of a scene; None = the default
    path: Path

    @property
    def stage_settings(self) -> tuple[str, ...]:
        """Return the settings of stages."""
        return tuple(line for line in self.settings if not line.startswith(_DISPLAY))

    @property
    def display_params(self) -> DisplayParams:
        """Return the display parameters; raises SettingProblem."""
        params = DisplayParams()
        for line in self.settings:
            if line.startswith(_DISPLAY):
                name, _, value = line.removeprefix(_DISPLAY).partition("=")
                params = replace_value(params, name.strip(), value.strip())
        return params


def format_settings(params: Mapping[str, object]) -> tuple[str, ...]:
    """Return the settings that turn the defaults into these parameters (stage or "display" ->
    parameters).
    """
    lines: list[str] = []
    for stage, given in params.items():
        usual = list_settings(type(given)())
        for name, (value, _) in list_settings(given).items():
            if value != usual[name][0]:
                lines.append(f"{stage}.{name}={_format_value(value)}")
    return tuple(lines)


def format_command(asked: ExportRequest) -> str:
    """Return the command line that writes the same file."""
    words = ["tactoscope", "export", *format_options(asked.request), "--pane", asked.pane]
    if asked.content != "computed":
        words += ["--content", asked.content]
    words += ["--frame", str(asked.frame)]
    if asked.frames:
        words += ["--frames", asked.frames]
    if asked.section:
        words += ["--section", *(_format_value(value) for value in asked.section)]
    if asked.size_px:
        words += ["--size", *(str(value) for value in asked.size_px)]
    words += [word for line in asked.settings for word in ("--set", line)]
    return shlex.join([*words, "--out", os.fspath(asked.path.absolute())])


def format_options(request: Request) -> list[str]:
    """Return the options that open `request`, without those that equal the defaults."""
    words = [os.fspath(request.recording.absolute()), "--target", request.target]
    usual = {field.name: field.default for field in fields(Request)}
    for name, option in _OPTIONS.items():
        value = getattr(request, name)
        if value != usual[name]:
            words += [
                option,
                os.fspath(value.absolute()) if isinstance(value, Path) else str(value),
            ]
    words += _several("--method", (f"{stage}={name}" for stage, name in request.methods))
    files = ((f"{stage}=" if stage else "", file.absolute()) for stage, file in request.weights)
    words += _several("--weights", (f"{of}{file}" for of, file in files))
    return [*words, *_offset_options(request.offsets)]


def _offset_options(offsets: Offsets) -> list[str]:
    words: list[str] = []
    for name in ("translation_mm", "rotation_deg", "pivot_mm"):
        values: tuple[float, ...] = getattr(offsets, name)
        if not offsets.is_zero and any(values):
            words += [f"--{name.replace('_', '-')}", *(_format_value(value) for value in values)]
    return words


def _several(option: str, values: Iterable[str]) -> Sequence[str]:
    return [word for value in values for word in (option, value)]


def _format_value(value: object) -> str:
    """Return a value as text that reads back unchanged, even where the command line takes 1e-05
    for an option.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return format(Decimal(repr(value)), "f")
    return str(value)
