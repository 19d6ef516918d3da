"""`tactoscope compare`: one frame several ways."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from pipeline.cli.translation_options import DEFAULT_OPTIONS, TranslationOptions

_Words = Annotated[str, Parameter(allow_leading_hyphen=True)]
_Settings = Annotated[tuple[str, ...], Parameter(name="--set", negative="")]


def compare(
    recording: Path,
    *,
    target: str,
    out: Path,
    opening: TranslationOptions = DEFAULT_OPTIONS,
    frame: int = 0,
    order: Literal["worst first", "best first", "in order"] = "worst first",
    seeds: int = 0,
    stage: str = "touch_depth",
    variant: _Words = "",
    across: str = "",
    down: str = "",
    figure: str = "touch_depth.contact_mae_mm",
    settings: _Settings = (),
) -> int:
    """Show one frame several ways, as the window's Compare: by every method, by several seeds, or beside another.

    Without `--seeds` and `--beside` it is every method of the touch. `--across` and `--down` try every pair of values
    of two parameters, as the window's Sweep does.

    Parameters
    ----------
    recording
        File or folder of any known format.
    target
        Sensor to translate to.
    out
        Folder for the pictures (PNG) and the figures (compare.json); an earlier comparison there is replaced.
    frame
        Which frame.
    order
        Of the methods, by their error in contact.
    seeds
        Draw the touch with so many seeds, the chosen one first.
    slot
        Which slot stands beside that of the other, or `all`.
    beside
        The other, in the options of this command: `--method view=paper`, for example. Without a recording of its own
        it is this one with these options in place, with one it is what these options say alone.
    across
        A parameter and the values to try, such as `depth.certainty=0.2,0.4,0.8`, against those of `down`.
    down
        The other parameter and its values.
    figure
        What judges a pair, where the truth is known, such as `touch_depth.contact_mae_mm`; empty for the picture alone.
    settings
        `slot.parameter=value`, or `slot/method.parameter=value` of a method that fills no slot here, or
        `display.parameter=value`, as often as needed.
    """
    from pipeline.cli.compare import ComparisonRequest, write_comparison

    wanted = ComparisonRequest(
        frame=frame,
        order=order,
        seeds=seeds,
        stage="" if stage == "all" else stage,
        variant=variant,
        across=across,
        down=down,
        metric=figure,
    )
    return write_comparison(recording, target, opening, settings, wanted, out)
