"""The headless commands. Each one's work is imported when it is called, so that `--help` answers at once."""

from __future__ import annotations

import errno
import io
import logging
import os
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from pipeline import __version__
from pipeline.base import error_log
from pipeline.base.errors import TouchError
from pipeline.base.text import hint_decimal_comma
from pipeline.cli import align_options as cli_align
from pipeline.cli import compare_options as cli_compare
from pipeline.cli import data_options as cli_data
from pipeline.cli import evaluate_options as cli_evaluate
from pipeline.cli import export_options as cli_hand_on
from pipeline.cli import live_options as cli_live
from pipeline.cli import train_options as cli_train
from pipeline.cli.terminal import print_error, print_line
from pipeline.cli.translation_options import (
    DEFAULT_OPTIONS,
    DepthUnit,
    Flag,
    RecordingPath,
    ReferenceImagePath,
    StageSettings,
    TargetName,
    TranslationOptions,
)

EXIT_UNEXPECTED = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130
_USERS_TO_MEND = frozenset(  # what a file system says to a name, wherever it is first asked about it
    (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.ELOOP, errno.ENAMETOOLONG, errno.EIO)
)


def build_app(name: str = "tactoscope") -> App:
    """The command line with all headless commands."""
    app = App(
        name=name,
        help="See one tactile sensor's touch become another's.",
        version=__version__,
        version_flags=["--version"],
        suppress_keyboard_interrupt=False,  # `run` says what an interruption leaves behind
    )
    app.command(inspect)
    app.command(translate)
    app.command(attribute)
    app.command(cli_compare.compare)
    app.command(cli_hand_on.export)
    app.command(cli_hand_on.bundle)
    app.command(cli_hand_on.replay)
    app.command(cli_live.live)
    app.command(cli_evaluate.evaluate)
    app.command(cli_data.simulate)
    app.command(prepare)
    app.command(doctor)
    app.command(bench)
    calibrate = App(name="calibrate", help="Build a sensor's colour-to-slope look-up from presses of a known object.")
    calibrate.command(cli_data.balls)
    app.command(calibrate)
    align = App(name="align", help="Judge, refine and fit how two sensors stand to each other.")
    align.command(cli_align.score)
    align.command(cli_align.refine)
    align.command(cli_align.fit)
    app.command(align)
    app.command(cli_train.build_train_app())
    return app


def main() -> None:
    """Entry of `python -m pipeline`."""
    sys.exit(run_app(build_app("python -m pipeline")))


def run_app(app: App, tokens: list[str] | None = None) -> int:
    """Run one command line; whatever goes wrong is one sentence on stderr, never a traceback.

    Returns the command's own code; 2 for a user's mistake, 130 after Ctrl-C, and 1 for what nobody foresaw, with its
    details kept in a file that the sentence names.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file's name may hold bytes that are no text
            stream.reconfigure(errors="backslashreplace")
    logging.getLogger("matplotlib").setLevel(
        logging.ERROR
    )  # where it keeps its fonts is no concern of a sheet's reader
    try:
        code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except (CycloptsError, TouchError) as error:
        told = str(error)
        print_error(told.removesuffix(".") + hint_decimal_comma(told) if told.endswith("into float.") else told)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("\ntactoscope: interrupted; finished frames are whole\n")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # who read our lines has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_UNEXPECTED
    except Exception as error:  # noqa: BLE001 - the last border
        if isinstance(error, OSError) and error.errno in _USERS_TO_MEND and error.filename is not None:
            print_error(f"{error.strerror}: '{os.fsdecode(error.filename)}'")
            return EXIT_USER_ERROR
        print_error(error_log.log_error(error))
        return EXIT_UNEXPECTED
    return code if isinstance(code, int) else 0


def inspect(
    recording: Path,
    *,
    sensor: str = "",
    reference: ReferenceImagePath = None,
    depth_unit: DepthUnit = "auto",
) -> int:
    """Say what a recording is: format, frames, sensor, truth, and whether its units and frames make sense.

    Of a calibration's file it says what error to expect. Exits with 0 if every check passed or could not be made, 1 if
    one failed.

    Parameters
    ----------
    recording
        File or folder of any known format, or a calibration.
    sensor
        The sensor that made it, where the file does not say.
    """
    from pipeline.calibration import calibration_file, quality_notes
    from pipeline.inspection.recording_report import format_report_lines
    from pipeline.inspection.recording_report import inspect_recording as report_on

    if calibration_file.is_calibration_file(recording):
        for line in quality_notes.format_calibration(calibration_file.load(recording)):
            print_line(line)
        return 0
    report = report_on(recording, sensor=sensor, reference=reference, depth_unit=depth_unit)
    for line in format_report_lines(report):
        print_line(line)
    return 0 if report.has_passed else 1


def translate(
    recording: RecordingPath,
    *,
    target: TargetName,
    out: Path,
    opening: TranslationOptions = DEFAULT_OPTIONS,
    frame: int | None = None,
    all_frames: Annotated[bool, Parameter(name="--all", negative="")] = False,
    follow: Flag = False,
    settings: StageSettings = (),
    scheduler: str = "",
) -> int:
    """Turn touches of one sensor into what another would have felt, and write every slot.

    Parameters
    ----------
    out
        Folder for `frame_NNNN/stages.npz`, `frame_NNNN/sheet.png` and `report.json`.
    frame
        The one frame to translate; the first one that touches if neither this nor --all is given.
    all_frames
        Translate every frame.
    follow
        With --all, begin each pose where the touch before ended: several times as quick, for moving sequences.
    scheduler
        With --all, address of a Dask scheduler whose workers translate the frames, such as `tcp://host:8786`.
    """
    from pipeline.cli.translate import translate_frames

    return translate_frames(
        opening.build_request(recording, target), out, frame, all_frames, settings, follow=follow, scheduler=scheduler
    )


def attribute(
    recording: Path,
    *,
    target: TargetName,
    opening: TranslationOptions = DEFAULT_OPTIONS,
    figure: str = "touch_depth.contact_mae_mm",
    frame: int | None = None,
    json: Path | None = None,
    settings: StageSettings = (),
) -> int:
    """Say which slot each frame's error comes from, by putting the truth in place of one after the other.

    Parameters
    ----------
    recording
        File or folder of any known format that knows the truth of its touches, such as simulated ones.
    figure
        The error to be taken apart, slot.name as `tactoscope translate` writes it into its report.
    frame
        The one frame to ask about; all of them otherwise, the worst first.
    json
        File for the parts of every frame.
    """
    from pipeline.cli.attribute import print_attribution

    return print_attribution(opening.build_request(recording, target), figure, frame, settings, json)


def prepare() -> int:
    """Compile what the sample and the simulator need, once, so that the first touch of a new process is quick."""
    from pipeline.cli.prepare import compile_kernels as compile_all

    return compile_all()


def doctor() -> int:
    """Check that this machine has all that Tactoscope needs, and say what to do where it has not."""
    from pipeline.cli.doctor import check_installation

    return check_installation()


def bench(
    *names: str,
    json: Path | None = None,
    plots: Path | None = None,
    against: Path | None = None,
    strict: Flag = False,
    list_only: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Measure run time against error, ours and baselines that can be installed, on this machine.

    Parameters
    ----------
    names
        Benchmarks to run; by default all that need neither recorded data nor a display.
    json
        File for the results, one row per claim.
    plots
        Folder for a plot of run time against error for each benchmark.
    against
        Results of an earlier run; rows that are worse by more than a tenth, or no longer meet their requirement, are listed.
    strict
        Exit with 1 if a requirement is not met or a benchmark fails; with --against, if a row got worse.
    list_only
        Only list the benchmarks.
    """
    from pipeline.cli.bench import load_bench_command

    command = load_bench_command()
    if list_only:
        return command.print_benchmarks()
    return command.run_benchmarks(names, json, plots, against=against, strict=strict)
