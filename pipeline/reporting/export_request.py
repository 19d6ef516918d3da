"""What somebody asks to have of a translation, on disk: told in full, so that it can be typed as a command too."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from decimal import Decimal
from pathlib import Path
from typing import Literal

from pipeline.base.params import list_settings, replace_value
from pipeline.engine.graph import Method
from pipeline.previews.display_params import DisplayParams
from pipeline.sensors.offsets import Offsets
from pipeline.translation.catalogue import with_settings
from pipeline.translation.translate import Request

SHEET, SOURCE = "sheet", "source"  # panes that are no slots: all of them side by side, and the reading itself
PaneContent = Literal["computed", "truth", "difference"]
_DISPLAY = "display."
_OPTIONS = {  # field of a request -> option of the command line
    "source": "--sensor", "stream": "--stream", "reference": "--reference", "calibration": "--calibration",
    "route": "--route", "mesh": "--mesh", "mesh_unit": "--mesh-unit", "depth_unit": "--depth-unit",
    "alignment": "--alignment",
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportRequest:
    """One file to be made; its suffix says of what kind."""

    request: Request
    settings: tuple[str, ...] = ()  # "slot.parameter=value", also "display.parameter=value"
    pane: str = SHEET  # a slot, SOURCE or SHEET; for a section several, with commas between
    content: PaneContent = "computed"
    frame: int = 0
    frames: str = ""  # of a table or a video, such as "0,3-7"; "" = all
    section: tuple[float, ...] = ()  # x, y of the beginning and of the end of a line in mm; () = none
    path: Path

    def parse_params(self, methods: tuple[Method, ...]) -> dict[str, object]:
        """Slot -> the parameters of its method; raises SettingProblem."""
        return with_settings(methods, [line for line in self.settings if not line.startswith(_DISPLAY)])

    @property
    def display_params(self) -> DisplayParams:
        """How things are drawn; raises SettingProblem."""
        params = DisplayParams()
        for line in self.settings:
            if line.startswith(_DISPLAY):
                name, _, value = line.removeprefix(_DISPLAY).partition("=")
                params = replace_value(params, name.strip(), value.strip())
        return params


def format_settings(params: Mapping[str, object]) -> tuple[str, ...]:
    """Slot (or "display") -> parameters, as the settings that make them of those that come by themselves."""
    lines: list[str] = []
    for slot, given in params.items():
        usual = list_settings(type(given)())
        for name, (value, _) in list_settings(given).items():
            if value != usual[name][0]:
                lines.append(f"{slot}.{name}={_said(value)}")
    return tuple(lines)


def format_command(asked: ExportRequest) -> str:
    """The command line that makes the very same file."""
    words = ["tactoscope", "export", *format_options(asked.request), "--pane", asked.pane]
    if asked.content != "computed":
        words += ["--content", asked.content]
    words += ["--frame", str(asked.frame)]
    if asked.frames:
        words += ["--frames", asked.frames]
    if asked.section:
        words += ["--section", *(_said(value) for value in asked.section)]
    words += [word for line in asked.settings for word in ("--set", line)]
    return shlex.join([*words, "--out", os.fspath(asked.path.absolute())])


def format_options(request: Request) -> list[str]:
    """The words of a command that open what `request` names, only those that differ from what comes by itself."""
    words = [os.fspath(request.recording.absolute()), "--target", request.target]
    usual = {field.name: field.default for field in fields(Request)}
    for name, option in _OPTIONS.items():
        value = getattr(request, name)
        if value != usual[name]:
            words += [option, os.fspath(value.absolute()) if isinstance(value, Path) else str(value)]
    words += _several("--method", (f"{slot}={name}" for slot, name in request.methods))
    files = ((f"{slot}=" if slot else "", file.absolute()) for slot, file in request.weights)
    words += _several("--weights", (f"{of}{file}" for of, file in files))
    return [*words, *_moved(request.offsets)]


def _moved(offsets: Offsets) -> list[str]:
    words: list[str] = []
    for name in ("translation_mm", "rotation_deg", "pivot_mm"):
        values: tuple[float, ...] = getattr(offsets, name)
        if not offsets.is_zero and any(values):
            words += [f"--{name.replace('_', '-')}", *(_said(value) for value in values)]
    return words


def _several(option: str, values: Iterable[str]) -> Sequence[str]:
    return [word for value in values for word in (option, value)]


def _said(value: object) -> str:
    """A value that reads back as it is, also where the command line would take 1e-05 for an option."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return format(Decimal(repr(value)), "f")
    return str(value)
