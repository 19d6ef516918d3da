"""The commands that hand something on: one file of a translation, a case, and a case played again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    RecordingPath,
    StageSettings,
    TargetName,
    TranslationOptions,
)

_DRAWN = "`slot.parameter=value`, or `display.parameter=value` for how it is drawn, as often as needed."
_DrawnSettings = Annotated[tuple[str, ...], Parameter(name="--set", negative="", help=_DRAWN)]

# Told here: in a docstring the word is the heading of a section.
_Note = Annotated[str, Parameter(help="What is to be seen in it.")]


def export(
    recording: RecordingPath,
    *,
    target: TargetName,
    out: Path,
    opening: TranslationOptions = DEFAULT_OPTIONS,
    pane: str = "sheet",
    shown: Literal["computed", "truth", "difference"] = "computed",
    frame: int = 0,
    frames: str = "",
    section: tuple[float, float, float, float] | None = None,
    settings: _DrawnSettings = (),
) -> int:
    """Write one file of a translation, the same as the window's Export: picture, points, arrays, table or video.

    Parameters
    ----------
    out
        The file: .png or .pdf of a pane or the sheet, .ply of a pane's points in mm, .npz of its arrays, .csv of every
        frame's figures, .mp4 or .avi of a pane through the frames.
    pane
        A slot, `source`, or `sheet` for all of them side by side.
    shown
        What the pane shows: what was worked out, the truth, or their difference, where the recording knows it.
    frame
        The frame of a picture, of points or of arrays.
    frames
        Frames of a table or a video, such as `0,3-7`; all otherwise.
    section
        x, y of the beginning and of the end of a line in mm from the source camera's axis, on the gel: the .csv is
        every height along it on one frame, of the panes named with commas between.
    """
    from pipeline.cli.export import run_export
    from pipeline.reporting.export_request import ExportRequest

    request = opening.build_request(recording, target)
    return run_export(
        ExportRequest(
            request=request,
            settings=settings,
            pane=pane,
            content=shown,
            frame=frame,
            frames=frames,
            section=section or (),
            path=out,
        )
    )


def bundle(
    recording: RecordingPath,
    *,
    target: TargetName,
    out: Path,
    opening: TranslationOptions = DEFAULT_OPTIONS,
    frame: int = 0,
    note: _Note = "",
    settings: StageSettings = (),
) -> int:
    """Put one frame with all that its translation reads, and what came out of it, into a folder that can be sent.

    Parameters
    ----------
    out
        The folder, which must not be there yet.
    frame
        Which frame.
    """
    from pipeline.cli.export import run_bundle

    return run_bundle(opening.build_request(recording, target), settings, frame, out, note)


def replay(folder: Path) -> int:
    """Play a case again: exits with 0 if every slot comes out as it did when the case was made, with 1 otherwise.

    Parameters
    ----------
    folder
        A folder as `tactoscope make-case` or the window's "Make a case" leaves it.
    """
    from pipeline.cli.export import run_replay

    return run_replay(folder)
