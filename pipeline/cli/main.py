"""Command line of the headless commands.

Commands are registered by import path: a command's module is imported only when that command runs,
so that `--help` loads neither numpy nor torch.
"""

import errno
import io
import logging
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path

from cyclopts import App, CycloptsError, UnknownOptionError

from pipeline import __version__
from pipeline.cli.terminal import print_error
from pipeline.core import user_folders
from pipeline.core.errors import SettingProblem, TouchError, hint_decimal_comma

EXIT_UNEXPECTED = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130
# File system errors that a user can correct; reported as one sentence with the file's name.
_USER_FILE_ERRORS = frozenset(
    (
        errno.EACCES,
        errno.EPERM,
        errno.EROFS,
        errno.ENOSPC,
        errno.EDQUOT,
        errno.ELOOP,
        errno.ENAMETOOLONG,
        errno.EIO,
    )
)

_OUTPUTS = ("out", "json", "plots", "record", "to", "tour")  # options of what commands write
# Command -> (module:function, help). The first sentence is listed by `tactoscope --help`.
_COMMANDS = {
    "inspect": (
        "inspect:inspect",
        """Report a recording's format, frames, sensors and truth, and check units and frames.

        For a calibration file, report its expected error. Exits with 1 if a check fails, otherwise
        with 0.""",
    ),
    "translate": (
        "translate:translate",
        "Translate frames from one sensor to another and write the result of every stage.",
    ),
    "attribute": (
        "attribute:attribute",
        "Attribute each frame's error to stages by replacing one stage's value after the other "
        "with the ground truth.",
    ),
    "track": (
        "track:track",
        """Follow a touched object through a recording without its mesh, and fuse its surface.

        Works on the source's depth, and on the depth of the generated touch.""",
    ),
    "compare": (
        "compare:compare",
        """Compare variants of one frame: touch methods, a grid of any two settings, or two runs.

        Without `--variant` and `--across` every touch method is compared.""",
    ),
    "export": (
        "export:export",
        "Write one file of a translation, as the window's Export does: image, points, arrays, "
        "table or video.",
    ),
    "bundle": (
        "export:bundle",
        "Write a repro bundle: a folder with one frame, all that its translation reads, and its "
        "results.",
    ),
    "replay": (
        "export:replay",
        "Replay a repro bundle of a frame or rollout. Exits with 0 if it gives the recorded "
        "result, otherwise with 1.",
    ),
    "live": (
        "live:live",
        "Show a live sensor's frame rate and losses every second, and record it if asked.",
    ),
    "evaluate": (
        "evaluate:evaluate",
        """Evaluate touch methods on held-out simulated touches, beside the paper's two tables.

        The touches are simulated, the paper's are real: compare difficulty, not quality. A method
        takes part if it has weights for the direction. Baselines are the reference image and the
        mean of other touches.""",
    ),
    "task": (
        "task:task",
        """Run a closed-loop task: a controller made for one sensor reads another's translation.

        The tasks are peg insertion and cup stacking, as in the paper; a TOML file adds a tool to
        insert.""",
    ),
    "simulate": (
        "simulate:simulate",
        """Simulate touches that several sensors record at once, with ground truth, as recordings.

        Ctrl-C keeps finished frames; the same command continues. The same seed gives the same
        frames.""",
    ),
    "prepare": (
        "prepare:prepare",
        "Compile all kernels once, so that the first touch of a new process is fast.",
    ),
    "doctor": ("doctor:doctor", "Check this installation and say how to fix what is missing."),
    "bench": (
        "bench:bench",
        "Measure run time and error of this project and of installed baselines on this machine.",
    ),
    "train": ("train:train_app", "Train networks and write their weights."),
}
_CALIBRATE = {
    "balls": (
        "calibrate:balls",
        "Fit a sensor's calibration table to presses of a ball and report its residuals.",
    ),
    "force": (
        "calibrate_force:force",
        "Scale the force of a sensor to two or more weighed presses.",
    ),
}
_ALIGN = {
    "score": (
        "align:score",
        "Score how well touches agree with the target's own recording, and which axis matters.",
    ),
    "refine": (
        "align:refine_alignment",
        "Refine an alignment on many touches and write it with its uncertainty.",
    ),
    "fit": ("align:fit_alignment", "Fit an alignment to paired touches without an initial one."),
}
_ROLLOUT = {
    "list": (
        "rollout:list_rollouts",
        "List the recorded rollouts of a folder with outcome, error and cause.",
    ),
    "attribute": (
        "rollout:attribute_recorded",
        "Say why a rollout fails: its error by stages, and what makes it succeed.",
    ),
    "video": (
        "rollout:video",
        "Write scene, touches and force of a rollout as a video, one image per tick.",
    ),
    "bundle": ("rollout:bundle", "Write a repro bundle of a rollout, for `tactoscope replay`."),
}


_GROUPS = {  # "" = the program itself
    "": ("", _COMMANDS),
    "calibrate": (
        "Calibrate a sensor by presses of a ball, and its force by weighed presses.",
        _CALIBRATE,
    ),
    "align": ("Score, refine and fit the alignment of two sensors.", _ALIGN),
    "rollout": ("List, attribute, film and bundle recorded rollouts of tasks.", _ROLLOUT),
}


def build_app(name: str = "tactoscope") -> App:
    """Command line with all headless commands."""
    app = App(
        name=name,
        help="Translate recordings of one tactile sensor into those of another.",
        version=__version__,
        version_flags=["--version"],
        suppress_keyboard_interrupt=False,  # `run_app` reports an interruption
    )
    for group, (help_text, commands) in _GROUPS.items():
        inner = App(name=group, help=help_text) if group else app
        for command, (path, text) in commands.items():
            inner.command(f"pipeline.cli.{path}", name=command, help=text)
        if group:
            app.command(inner)
    return app


def main() -> None:
    """Entry point of `python -m pipeline`."""
    sys.exit(run_app(build_app("python -m pipeline")))


def run_app(app: App, tokens: list[str] | None = None) -> int:
    """Run one command line. Errors become one sentence on stderr, never a traceback.

    Returns the command's exit code, 2 for a user error, 130 after Ctrl-C, and 1 for an unexpected
    error, whose details are written to a log file that the sentence names.
    """
    # None where it is closed, as by 2>&-
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file name may hold bytes that are not text
            stream.reconfigure(errors="backslashreplace")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # hides its messages about font caches
    try:
        _refuse_empty_paths(sys.argv[1:] if tokens is None else tokens)
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        _refuse_lossy_outputs(bound.arguments)
        code = command(*bound.args, **bound.kwargs)
    except (CycloptsError, TouchError) as error:
        text = str(error)
        if text.endswith("into float."):
            text = text.removesuffix(".") + hint_decimal_comma(text)
        if isinstance(error, UnknownOptionError):
            command = " ".join((app.name[0], *(error.command_chain or ())))
            text = f"{text} '{command} --help' lists the options"
        print_error(text)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("\ntactoscope: interrupted; finished frames are complete\n")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of stdout has closed it, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_UNEXPECTED
    except Exception as error:  # noqa: BLE001 - the outermost handler
        if isinstance(error, OSError) and error.errno in _USER_FILE_ERRORS:
            place = "the output" if error.filename is None else f"'{os.fsdecode(error.filename)}'"
            print_error(f"{error.strerror}: {place}")
            return EXIT_USER_ERROR
        print_error(user_folders.log_error(error))
        return EXIT_UNEXPECTED
    return code if isinstance(code, int) else 0


def _refuse_empty_paths(tokens: Sequence[str]) -> None:
    """Raise SettingProblem for an empty path, which would be the current folder."""
    for before, token in pairwise(("", *tokens)):
        if not token and (not before.startswith("-") or before.lstrip("-") in _OUTPUTS):
            raise SettingProblem(
                f"the path after {before!r} is empty; is it a variable that is not set?"
            )


def _refuse_lossy_outputs(arguments: Mapping[str, object]) -> None:
    """Raise FileProblem where a command would write over what it reads."""
    outputs = [out for name in _OUTPUTS for out in _list_paths(arguments.get(name))]
    if outputs:
        from pipeline.core.files import require_separate  # imports numpy

        inputs = [
            path
            for name, value in arguments.items()
            if name not in _OUTPUTS
            for path in _list_paths(value)
        ]
        for out in outputs:
            require_separate(out, inputs)


def _list_paths(value: object) -> list[Path]:
    """Return every path in an option, and every text that may be one, such as
    `touch=weights.safetensors`.
    """
    if isinstance(value, (str, Path)):
        text = value.rpartition("=")[2] if isinstance(value, str) else value
        return [Path(text)] if text else []
    if is_dataclass(value):
        value = [getattr(value, f.name) for f in fields(value)]
    return (
        [path for part in value for path in _list_paths(part)]
        if isinstance(value, (list, tuple))
        else []
    )
