"""The headless commands. Each one's work is imported when it is called, so that `--help` answers at once."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, CycloptsError, Parameter

from pipeline.errors import TouchError

EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130


def build(name: str = "tactoscope") -> App:
    """The command line with all headless commands."""
    app = App(
        name=name,
        help="See one tactile sensor's touch become another's.",
        version_flags=["--version"],
        suppress_keyboard_interrupt=False,  # `run` says what an interruption leaves behind
    )
    app.version = "0.1.0"
    app.command(inspect)
    app.command(translate)
    app.command(simulate)
    app.command(doctor)
    app.command(bench)
    calibrate = App(name="calibrate", help="Build a sensor's colour-to-slope look-up from presses of a known object.")
    calibrate.command(balls)
    app.command(calibrate)
    align = App(name="align", help="Judge and refine how two sensors stand to each other.")
    align.command(align_score, name="score")
    align.command(align_refine, name="refine")
    app.command(align)
    return app


def main() -> None:
    """Entry of `python -m pipeline`."""
    sys.exit(run(build("python -m pipeline")))


def run(app: App, tokens: list[str] | None = None) -> int:
    """Run one command line; a user's mistake is one sentence on stderr and exit code 2, never a traceback."""
    try:
        code = app(tokens, exit_on_error=False, print_error=True, result_action="return_value")
    except CycloptsError:
        return EXIT_USER_ERROR
    except TouchError as error:
        sys.stderr.write(f"tactoscope: {error}\n")
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        sys.stderr.write("\ntactoscope: interrupted; finished frames are whole\n")
        return EXIT_INTERRUPTED
    return code if isinstance(code, int) else 0


def inspect(recording: Path, *, sensor: str = "", reference: Path | None = None) -> int:
    """Say what a recording is: format, frames, sensor, truth, and whether its units and frames make sense.

    Parameters
    ----------
    recording
        File or folder of any known format.
    sensor
        The sensor that made it, where the file does not say.
    reference
        Image of the untouched sensor, where the recording holds none.
    """
    from pipeline.commands.inspect import show

    return show(recording, sensor, reference)


def translate(
    recording: Path,
    *,
    target: str,
    out: Path,
    sensor: str = "",
    stream: str = "",
    reference: Path | None = None,
    calibration: Path | None = None,
    route: str = "t2d2",
    frame: int | None = None,
    all_frames: Annotated[bool, Parameter(name="--all", negative="")] = False,
    mesh: Path | None = None,
    mesh_unit: Literal["auto", "mm", "cm", "m"] = "auto",
    alignment: Path | None = None,
    depth_unit: Literal["auto", "mm", "m", "0.1mm", "um"] = "auto",
    settings: Annotated[tuple[str, ...], Parameter(name="--set")] = (),
) -> int:
    """Turn touches of one sensor into what another would have felt, and write every stage.

    Parameters
    ----------
    recording
        File or folder of any known format.
    target
        Sensor to translate to.
    out
        Folder for `frame_NNNN/stages.npz`, `frame_NNNN/sheet.png` and `report.json`.
    sensor
        The sensor that made the recording, where the file does not say; also chooses one of several streams.
    stream
        Name of the stream, where one sensor has several.
    reference
        Image of the untouched sensor, where the recording holds none.
    calibration
        Look-up made by `tactoscope calibrate balls`; the sensor's built-in one otherwise.
    route
        Way through the stages.
    frame
        The one frame to translate; the first one that touches if neither this nor --all is given.
    all_frames
        Translate every frame.
    mesh
        The touched object's mesh, for its pose.
    mesh_unit
        Unit of that mesh.
    alignment
        How the two sensors stand to each other, a .toml as `tactoscope align refine` writes it.
    depth_unit
        Unit of a depth array whose name does not tell.
    settings
        `stage.parameter=value`, as often as needed.
    """
    from pipeline.commands.translate import translate_frames
    from pipeline.translate import Request

    request = Request(
        recording=recording, target=target, source=sensor, stream=stream, route=route,
        reference=reference, calibration=calibration, mesh=mesh, mesh_unit=mesh_unit,
        depth_unit=depth_unit, alignment=alignment,
    )  # fmt: skip
    return translate_frames(request, out, frame, all_frames, settings)


def simulate(
    *,
    sensors: str,
    tools: str,
    out: Path,
    poses: int = 60,
    seed: int = 0,
    sequence: Literal["grid", "press", "slide", "twist", "release", "all"] = "grid",
    vary: float = 0.0,
    noise: bool = True,
    bubble_deeper_mm: float = 9.0,
    drag_mm: float = 0.0,
    jobs: int = 2,
    mesh_unit: Literal["auto", "mm", "cm", "m"] = "auto",
    mesh_face: Literal["-x", "+x", "-y", "+y", "-z", "+z"] = "-z",
) -> int:
    """Simulate touches that several sensors feel at once, with all that is true of them, as recordings.

    Ctrl-C keeps what is finished; the same command goes on from there. The same seed gives the same readings.

    Parameters
    ----------
    sensors
        Sensors that feel the same presses, such as `gelslim,soft_bubble`.
    tools
        Objects, such as `NAME,NAME`; the groups `training`, `unseen`, `task` or `all`; or a mesh file.
    out
        One `.h5` file for one object, otherwise a folder that gets one `.h5` for each.
    poses
        Single grasps of each object, or frames of the sequence.
    seed
        Seed of poses, noise and specimens.
    sequence
        `grid` is single grasps over 10 mm x 10 mm and up to 45 degrees; the others are moving touches, and `all` is
        press, slide, twist and release in a row.
    vary
        How far specimens of a sensor differ, 1 = as much as real ones; a new specimen is taken every ten moments.
    noise
        Whether readings have their camera's noise.
    bubble_deeper_mm
        How much farther a bubble comes to meet the object than its description says.
    drag_mm
        How far each object has gone along the gels since it touched them, at a friction of 0.8: markers move with it.
    jobs
        Processes that work at once.
    mesh_unit
        Unit of a mesh file.
    mesh_face
        Side of a mesh file that touches, such as `--mesh-face=-x`.
    """
    from pipeline.commands.simulate import simulate_recordings
    from pipeline.physics.datasets import Plan

    like = Plan(
        sensors=_words(sensors), tool="", poses=poses, seed=seed, sequence=sequence, vary=vary, noise=noise,
        bubble_deeper_mm=bubble_deeper_mm, drag_mm=drag_mm,
        mesh_unit=mesh_unit, mesh_face=mesh_face,
    )  # fmt: skip
    return simulate_recordings(_words(tools), like, out, jobs)


def _words(listed: str) -> tuple[str, ...]:
    return tuple(word for word in (part.strip() for part in listed.split(",")) if word)


def balls(
    presses: Path,
    *,
    sensor: str,
    diameter_mm: float,
    reference: Path,
    out: Path,
    pixel_mm: float | None = None,
    pattern: str = "*",
    seed: int = 0,
) -> int:
    """Fit a sensor's colour-to-slope look-up to presses of a ball, and report how well it fits.

    Parameters
    ----------
    presses
        Folder of images, one press each, anywhere on the gel.
    sensor
        The sensor that made them.
    diameter_mm
        Diameter of the ball.
    reference
        Image of the untouched sensor.
    out
        Look-up file to write (.npz).
    pixel_mm
        Width of a pixel on the gel; the sensor description's if not given.
    pattern
        Which file names of the folder to use, such as `ball_6.310mm_*`.
    seed
        Seed of the fit; the same seed gives the same look-up.
    """
    from pipeline.commands.calibrate import calibrate_balls_command

    return calibrate_balls_command(presses, sensor, diameter_mm, reference, out, pixel_mm, pattern, seed)


def doctor() -> int:
    """Check that this machine has all that Tactoscope needs, and say what to do where it has not."""
    from pipeline.commands.doctor import examine

    return examine()


def bench(
    *names: str,
    json: Path | None = None,
    plots: Path | None = None,
    strict: Annotated[bool, Parameter(negative="")] = False,
    list_questions: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Race our stages against what one can install: run time against error, on this machine.

    Parameters
    ----------
    names
        Questions to answer; all that need neither recorded data nor a display if none is given.
    json
        File for the results, one row per claim.
    plots
        Folder for a picture of run time against error for each question.
    strict
        Exit with 1 if a bar does not hold or a question has no answer.
    list_questions
        Only list the questions.
    """
    from pipeline.commands.bench import bench as ask
    from pipeline.commands.bench import list_questions as show

    return show() if list_questions else ask(names, json, plots, strict=strict)


def align_score(
    recording: Path,
    *,
    target: str,
    sensor: str = "",
    alignment: Path | None = None,
    frames: str = "",
    truth: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Say how well touches agree with what the target really felt of them, and which axis matters.

    Parameters
    ----------
    recording
        A recording in which both sensors took part.
    target
        Sensor to carry touches to.
    sensor
        The sensor that they come from; the recording's first otherwise.
    alignment
        The .toml to judge; what the recording or the sensor descriptions say otherwise.
    frames
        Frames such as `0,3-7`; all otherwise.
    truth
        Compare the recording's exact depth and contact, not what the depth stage makes of the pictures.
    """
    from pipeline.commands.align import show_scores
    from pipeline.translate import Request

    request = Request(recording=recording, target=target, source=sensor, alignment=alignment)
    return show_scores(request, frames, truth)


def align_refine(
    recording: Path,
    *,
    target: str,
    out: Path,
    sensor: str = "",
    alignment: Path | None = None,
    frames: str = "",
    hold_out: float = 0.2,
    into: Literal["alignment_from_source", "target_from_alignment"] = "target_from_alignment",
    tolerance: float = 1.0,
    truth: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Fit an alignment to many touches at once, say what they do not tell, and write it.

    Parameters
    ----------
    recording
        A recording in which both sensors took part.
    target
        Sensor to carry touches to.
    out
        The .toml to write.
    sensor
        The sensor that touches come from; the recording's first otherwise.
    alignment
        The .toml to begin with; what the recording or the sensor descriptions say otherwise.
    frames
        Frames such as `0,3-7`; all otherwise.
    hold_out
        Share of the touches that are not used, only judged before and after.
    into
        Which of the two transforms takes the change.
    tolerance
        Directions that the touches tell to no better than this times 0.2 mm or 1 degree are left as they were.
    truth
        Use the recording's exact depth and contact, not what the depth stage makes of the pictures.
    """
    from pipeline.commands.align import refine_alignment
    from pipeline.translate import Request

    request = Request(recording=recording, target=target, source=sensor, alignment=alignment)
    return refine_alignment(request, out, frames, hold_out=hold_out, into=into, tolerance=tolerance, exact=truth)
