"""Tactoscope in Python: the touch of one tactile sensor as another's, stage by stage.

    import tactoscope as ts

    touches = ts.open("first_touch.h5", target="soft_bubble")
    frame = touches[5]                    # nothing is computed until it is asked for
    frame.depth.indentation_mm            # (rows, cols) mm
    frame.touch.image                     # the generated touch
    frame.pose.matrix, frame.notes, frame.metrics
    touches.with_(steps=8)[5].touch       # computes only what differs

Lengths are mm, times s, angles rad; a name says its unit. A sensor's frame is its camera frame: x
right, y down, z out along the optical axis. "No value" is NaN, never 0. Arrays are read-only.
Whatever a user can mend is a `TouchError`, one sentence with what is wrong, where, and what to try.

The `tactoscope` command starts here as well (`main`).
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar, cast, get_args

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

    from numpy.typing import ArrayLike

    from pipeline.calibration.calibration_file import save as save_calibration
    from pipeline.calibration.calibration_table import Calibration
    from pipeline.core.errors import TouchError
    from pipeline.core.geometry.meshes import Mesh, load_mesh
    from pipeline.core.graph import Fallback, Method, Skipped
    from pipeline.core.params import NoParams, Value, setting
    from pipeline.core.values.frames import Recording, Stream, TactileFrame, Truth
    from pipeline.core.values.results import DepthMap, GeneratedTouch, ObjectPose, make_depth_map
    from pipeline.io.format_dispatch import open_recording
    from pipeline.io.formats import RecordingFormat, register_format
    from pipeline.io.in_memory import make_recording
    from pipeline.lab.tracking.track_record import TrackRecord
    from pipeline.sensors.spec import SensorSpec, load_sensor
    from pipeline.translation.alignment.refine import Refinement
    from pipeline.translation.live_translation import LiveResult
    from pipeline.translation.translate import Translation
    from pipeline.translation.translated_frame import TranslatedFrame

__all__ = [
    "Calibration",
    "DepthMap",
    "Fallback",
    "GeneratedTouch",
    "Method",
    "NoParams",
    "ObjectPose",
    "Recording",
    "RecordingFormat",
    "Refinement",
    "SensorSpec",
    "Skipped",
    "Stream",
    "TactileFrame",
    "TouchError",
    "TrackRecord",
    "TranslatedFrame",
    "Translation",
    "Truth",
    "align",
    "calibrate",
    "depth",
    "live",
    "load_mesh",
    "load_sensor",
    "main",
    "make_depth_map",
    "make_recording",
    "open",
    "open_recording",
    "register_format",
    "save_alignment",
    "save_calibration",
    "setting",
    "simulate",
    "track",
    "train",
]

PathLike: TypeAlias = "str | os.PathLike[str]"
_Args = ParamSpec("_Args")
_Result = TypeVar("_Result")

# Name -> module that defines it: imported on first use, so that `import tactoscope` loads no
# library.
_HOMES = {
    "Calibration": "pipeline.calibration.calibration_table",
    "DepthMap": "pipeline.core.values.results",
    "Fallback": "pipeline.core.graph",
    "GeneratedTouch": "pipeline.core.values.results",
    "Method": "pipeline.core.graph",
    "NoParams": "pipeline.core.params",
    "ObjectPose": "pipeline.core.values.results",
    "Recording": "pipeline.core.values.frames",
    "RecordingFormat": "pipeline.io.formats",
    "Refinement": "pipeline.translation.alignment.refine",
    "SensorSpec": "pipeline.sensors.spec",
    "Skipped": "pipeline.core.graph",
    "Stream": "pipeline.core.values.frames",
    "TactileFrame": "pipeline.core.values.frames",
    "TouchError": "pipeline.core.errors",
    "TrackRecord": "pipeline.lab.tracking.track_record",
    "TranslatedFrame": "pipeline.translation.translated_frame",
    "Translation": "pipeline.translation.translate",
    "Truth": "pipeline.core.values.frames",
    "load_mesh": "pipeline.core.geometry.meshes",
    "load_sensor": "pipeline.sensors.spec",
    "make_depth_map": "pipeline.core.values.results",
    "make_recording": "pipeline.io.in_memory",
    "open_recording": "pipeline.io.format_dispatch",
    "register_format": "pipeline.io.formats",
    "save_calibration": "pipeline.calibration.calibration_file:save",
    "setting": "pipeline.core.params",
}


def __getattr__(name: str) -> Any:
    """Return a name of `__all__` from the module that defines it."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, own_name = _HOMES[name].partition(":")
    value = getattr(importlib.import_module(module), own_name or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


def _name_arguments(act: Callable[_Args, _Result]) -> Callable[_Args, _Result]:
    """Let errors name the arguments of a function where they name options of the command line."""

    @functools.wraps(act)
    def call(*args: _Args.args, **kwargs: _Args.kwargs) -> _Result:
        from pipeline.core.errors import TouchError, name_options

        try:
            return act(*args, **kwargs)
        except TouchError as error:
            error.args = (name_options(str(error), act.__annotations__),)
            raise

    return call


@_name_arguments
def open(  # noqa: A001 - `ts.open` reads as it should
    recording: PathLike | Recording | ArrayLike | Sequence[ArrayLike],
    target: str,
    *,
    source: str = "",
    stream: str = "",
    route: str = "",
    methods: Mapping[str, str | Method] | None = None,
    weights: Mapping[str, PathLike] | None = None,
    reference: PathLike | ArrayLike | None = None,
    calibration: PathLike | None = None,
    alignment: PathLike | None = None,
    mesh: PathLike | Mesh | None = None,
    meshes: PathLike | None = None,
    mesh_unit: str = "auto",
    device: str = "auto",
) -> Translation:
    """Open touches of one sensor, to be translated to another.

    Args:
        recording: File or folder of any known format; a `Recording`; or images of one sensor: (n,
            rows, cols, 3) uint8 RGB of a gel, (n, rows, cols) depth in mm of a bubble.
        target: Sensor to translate to: its name (`gelslim`, `digit`, `gelsight_mini`,
            `soft_bubble`, ...) or a TOML file of your own.
        source: Sensor that made the recording, by name or TOML file; "" = as the recording says.
            Images need it.
        stream: Name of the stream to read, where one sensor has several; "" = the first.
        route: `object` (by the object's mesh), `t2d2` (touch to depth to touch) or `t2t` (touch to
            touch); default: `object` where a mesh is known, else `t2d2`.
        methods: Stage -> name of its method, or a `Method` of your own; the route names those of
            other stages.
        weights: Stage -> weights file of its network; shipped ones otherwise.
        reference: Image without contact: a file or, of images, also an array as they are; None =
            the recording's own.
        calibration: Calibration file of the source; None = the built-in table of its kind.
        alignment: Alignment of the two sensors, a TOML file; None = the recording's, else that of
            the descriptions.
        mesh: Mesh of the touched object, for its touch and pose, a file or what `load_mesh`
            returns; None = the recording's.
        meshes: Folder of meshes in place of one: the likeliest by the frame that differs most from
            its reference, with its margin in `notes`.
        mesh_unit: Unit of those files: `mm`, `cm`, `m`, `in`; `auto` = mm, where the size allows.
        device: Where networks run: `cpu`, `cuda`, `cuda:1` (of several) or `mps`; `auto` = on a
            card where there is one and the network is of published size.

    Returns:
        The translation: `len()`, `[i]`, a loop, `with_(method=..., steps=8)`; it closes at the end
        of a `with` block.

    Raises:
        TouchError: A file cannot be read, or a sensor, stage or method is not known; the sentence
            says what to try.
    """
    from pipeline.core.errors import SettingProblem
    from pipeline.core.geometry.meshes import Mesh
    from pipeline.translation.translate import Request, open_translation

    if mesh is not None and meshes is not None:
        raise SettingProblem("give either mesh, the object, or meshes, a folder to choose it from")
    is_file = isinstance(recording, (str, os.PathLike))
    own = {
        stage: method for stage, method in (methods or {}).items() if not isinstance(method, str)
    }
    at_hand = None
    path = Path(os.fspath(recording)) if is_file else Path("arrays")
    if not is_file:
        at_hand = _make_recording(recording, source, reference)
        path = at_hand.path
    elif not (reference is None or isinstance(reference, (str, os.PathLike))):
        raise SettingProblem(
            "the reference of a file is a file; give its path, or give the images as arrays as well"
        )
    request = Request(
        recording=path,
        target=target,
        source=source,
        stream=stream,
        route=route,
        methods=tuple(
            (stage, name) for stage, name in (methods or {}).items() if isinstance(name, str)
        ),
        weights=tuple((stage, Path(file)) for stage, file in (weights or {}).items()),
        refuses_unusable_weights=True,
        reference=Path(reference)
        if is_file and isinstance(reference, (str, os.PathLike))
        else None,
        calibration=None if calibration is None else Path(calibration),
        alignment=None if alignment is None else Path(alignment),
        mesh=None if mesh is None or isinstance(mesh, Mesh) else Path(mesh),
        mesh_unit=mesh_unit,
        device=device,
    )
    translation = open_translation(
        request, recording=at_hand, mesh=mesh if isinstance(mesh, Mesh) else None
    )
    if meshes is not None:
        from pipeline.translation.object_identification import take_likeliest_mesh

        translation = take_likeliest_mesh(translation, Path(meshes))
    for stage, method in own.items():
        translation = translation.with_(stage=stage, method=method)
    return translation


@_name_arguments
def live(
    source: str,
    target: str,
    *,
    sensor: str = "",
    partner: str = "",
    partner_sensor: str = "",
    shape: str = "sphere",
    rate_hz: float = 0.0,
    route: str = "t2d2",
    device: str = "auto",
) -> Iterator[LiveResult]:
    """Translate a live sensor on all cores: a loop over its newest frames, until it is left.

    The work is done by processes that import the program again: in a script, call it under `if
    __name__ == "__main__":`.

    Args:
        source: `simulated`, `camera:0`, a folder that grows (`folder DIR`), `http://...`,
            `ws://HOST:PORT TOPIC`, ...: what `tactoscope live --source` takes.
        target: Sensor to translate to, by name or TOML file.
        sensor: Sensor of the source, where it does not tell, or which one is simulated.
        partner: Second sensor that touches the same object, named as the source is, paired by time:
            what the target's own sensor takes is the truth of the frame's `metrics`.
        partner_sensor: Sensor of the partner; "" = the target's.
        shape: Name of a shape, or mesh file, that touches a simulated sensor.
        rate_hz: Frames a second to keep up with, by leaving out what the frame's `plan` says; 0 =
            all of every frame, as many as come out.
        route: `t2d2`, `t2t` or `object`.
        device: Where networks run, as for `open`.

    Returns:
        For each frame `frame`, `results` (stage -> its result, with `output` and `notes`), `age_s`,
        `plan`, and where something is known of it `truth` and `metrics`, as of a recorded frame.

    Raises:
        TouchError: The source, a sensor or the route is not known, or the loop has waited for ten
            seconds for a sensor that is not there.
    """
    from pipeline.io.live.source_parsing import parse_sources
    from pipeline.translation.live_translation import translate_live
    from pipeline.translation.translate import Request

    opened, beside = parse_sources(
        [source],
        [partner],
        sensor=sensor,
        partner_sensor=partner_sensor,
        target=target,
        tool=shape,
        rate_hz=rate_hz or 15.0,
    )
    name = Path(f"live:/{id(opened)}")  # two loops at once are of two sensors
    return translate_live(
        opened, Request(recording=name, target=target, route=route, device=device), rate_hz, beside
    )


def _make_recording(
    images: Recording | ArrayLike | Sequence[ArrayLike], sensor: str, reference: object
) -> Recording:
    from pipeline.core.errors import SettingProblem
    from pipeline.core.values.frames import Recording
    from pipeline.io.in_memory import make_recording
    from pipeline.sensors.spec import load_sensor

    if isinstance(images, Recording):
        return images
    if not sensor:
        raise SettingProblem(
            "arrays do not say which sensor made them; give source, such as source='digit'"
        )
    return make_recording(images, cast("Any", reference), load_sensor(sensor))


@_name_arguments
def depth(
    image: ArrayLike,
    reference: PathLike | ArrayLike,
    sensor: str,
    *,
    method: str | Method = "",
    calibration: PathLike | None = None,
    **settings: Value,
) -> DepthMap:
    """Measure the depth of one tactile image.

    Args:
        image: (rows, cols, 3) uint8 RGB of a gel, or (rows, cols) depth in mm of a bubble, NaN = no
            value.
        reference: The same sensor without contact, of the same shape and type, or its file.
        sensor: The sensor that made both: its name, or a TOML file of your own.
        method: Method of the stage `depth`; "" = the one for this kind of sensor.
        calibration: Calibration file of the sensor; None = the built-in table of its kind.
        settings: Parameters of the method.

    Returns:
        `indentation_mm` (0 untouched, positive toward the camera), `depth_mm` and `contact`, each
        (rows, cols) in the sensor's camera frame, and `notes`: sentences about what may be wrong.

    Raises:
        TouchError: Shapes, types or names are wrong.
    """
    opened = open([image], sensor, source=sensor, reference=reference, calibration=calibration)
    return opened.with_(stage="depth", method=method, **settings)[0].depth


@_name_arguments
def simulate(
    shape: PathLike,
    sensors: str | Sequence[str],
    n: int = 10,
    *,
    seed: int = 0,
    sequence: str = "grid",
) -> Recording:
    """Simulate touches that several sensors record at once, with their truth.

    Args:
        shape: Name of a shape, as `tactoscope simulate --help` lists them, or a mesh file.
        sensors: The sensors, or the one, by name or TOML file.
        n: Number of touches.
        seed: The same seed gives the same frames.
        sequence: `grid` (single touches at poses of a grid), or a motion: `press`, `slide`,
            `twist`, `release`, `all`.

    Returns:
        A recording for `ts.open`; a touch is simulated when it is first read.

    Raises:
        TouchError: There is no such shape, sensor or sequence, or the mesh cannot be used.
    """
    from pipeline.core.errors import SettingProblem
    from pipeline.physics.simulation.datasets import (
        PoseSequence,
        SimulationPlan,
        make_plans,
        make_recording,
    )

    if sequence not in get_args(PoseSequence):
        raise SettingProblem(
            f"no sequence {sequence!r}; there are {', '.join(get_args(PoseSequence))}"
        )
    kind = cast("PoseSequence", sequence)
    plan = SimulationPlan(
        sensors=(sensors,) if isinstance(sensors, str) else tuple(sensors),
        object_source="",
        n_poses=n,
        seed=seed,
        sequence=kind,
    )
    first, *others = make_plans((os.fspath(shape),), plan)
    if others:
        raise SettingProblem(f"{shape!r} is a group of {1 + len(others)} shapes; give one of them")
    return make_recording(first)


@_name_arguments
def align(touches: Translation, frames: Iterable[int] | None = None) -> Refinement:
    """Refine the alignment of two sensors on touches that both recorded.

    Args:
        touches: Translation of a recording that holds both sensors.
        frames: Numbers of the frames to use; None = all.

    Returns:
        `alignment`, to be used by `touches.with_alignment(...)`; `std`, its predicted standard
        deviation (3 degrees, 3 mm); `weak_directions` that the touches do not determine, which are
        left as they were.

    Raises:
        SettingProblem: No frame has contact on both sensors.
    """
    from pipeline.translation.alignment.refine import refine_on_recording

    return refine_on_recording(touches, range(len(touches)) if frames is None else frames)


def save_alignment(touches: Translation, path: PathLike) -> None:
    """Write the alignment of two sensors as a TOML file, for `ts.open(..., alignment=path)`.

    Raises FileProblem.
    """
    from pipeline.sensors.alignment import AlignmentFile
    from pipeline.sensors.alignment import save_alignment as save

    origin = f"in use on {touches.recording.path.name}"
    names = touches.source.name, touches.target.name
    save(
        Path(path),
        AlignmentFile(alignment=touches.alignment, source=names[0], target=names[1], origin=origin),
    )


@_name_arguments
def calibrate(
    images: Sequence[ArrayLike],
    reference: PathLike | ArrayLike,
    sensor: str,
    diameter_mm: float,
    *,
    pixel_mm: float | None = None,
) -> Calibration:
    """Fit the calibration table of a gel to presses of a ball.

    Args:
        images: Presses (rows, cols, 3) uint8 RGB, one ball each, anywhere on the gel; ten or more.
        reference: The same sensor without contact, or its file.
        sensor: The sensor that made them.
        diameter_mm: Diameter of the ball.
        pixel_mm: Width of a pixel on the gel; None = the sensor description's.

    Returns:
        The table, with the residual of each press; write it by `save_calibration(table, path)`, use
        it by `touches.with_calibration(table)`.

    Raises:
        TouchError: The presses cannot be used.
    """
    from pipeline.io.in_memory import make_recording
    from pipeline.sensors.spec import load_sensor
    from pipeline.stages.depth.ball_calibration import calibrate_sensor

    spec = load_sensor(sensor)
    stream = make_recording(images, reference, spec).stream()
    frames = [stream.frame(index) for index in range(stream.n_frames)]
    presses: list[Any] = [frame.image for frame in frames]
    rest: Any = frames[0].reference
    return calibrate_sensor(presses, rest, spec, diameter_mm, pixel_mm=pixel_mm)


@_name_arguments
def track(
    touches: Translation, stage: str = "depth", frames: Iterable[int] | None = None
) -> TrackRecord:
    """Follow a touched object through a recording without its mesh, and fuse what was touched into
    a surface.

    Args:
        touches: An opened translation.
        stage: Membrane to follow: `depth` (the source's) or `touch_depth` (of the generated
            touches).
        frames: Numbers of the frames in order; None = all.

    Returns:
        `rows`, one a frame with its state and motion; `patch`, the fused surface; `error`, the
        drift where true poses are known.

    Raises:
        TouchError: No frame can be read.
    """
    from pipeline.lab.tracking.track_recording import track_recording

    return track_recording(touches, stage, range(len(touches)) if frames is None else list(frames))


@_name_arguments
def train(
    what: str,
    out: PathLike,
    *,
    pairs: PathLike | None = None,
    recipe: str = "",
    hold_out: str = "",
    steps: int | None = None,
    minutes: float | None = None,
    workers: int = 0,
) -> Path:
    """Train a network, on recorded pairs of two sensors or on simulated touches.

    Args:
        what: What to train, as `tactoscope train --help` lists it, such as `t2t` or `vqvae`.
        out: Folder for the state, curves and weights. The same call again continues a run that was
            stopped there, or returns the weights of one that has ended.
        pairs: Recording or folder of both sensors; None = simulated touches.
        recipe: Name of a shipped recipe or a TOML file; "" = that for pairs of `what`.
        hold_out: Pairs that only validate, as in `tactoscope train --help`.
        steps: Number of steps; None = the recipe's.
        minutes: Time in all, instead of steps.
        workers: Processes that make examples; 0 = this one. A script that takes some runs under
            `if __name__ == "__main__":`.

    Returns:
        The weights file, for `ts.open(..., weights={"touch": file})`.

    Raises:
        TouchError: The recipe, the pairs or the folder cannot be used.
    """
    from pipeline.core.errors import SettingProblem
    from pipeline.lab.training.loop import TrainingRun
    from pipeline.lab.training.loop import train as train_run
    from pipeline.lab.training.recipe import (
        list_shipped_recipes,
        load_recipe,
        override_pairs,
        override_training,
    )
    from pipeline.lab.training.run_folder import export_run
    from pipeline.lab.training.task import TASKS

    known = sorted({task.subcommand for task in TASKS.values()})
    if what not in known:
        raise SettingProblem(
            f"nothing called {what!r} can be trained; there are {', '.join(known)}"
        )
    if pairs is None and not recipe:
        raise SettingProblem(
            f"give pairs to train {what} on, or a recipe: {', '.join(list_shipped_recipes(what))}"
        )
    chosen = load_recipe(recipe or f"{what}_pairs", what)
    folder = Path(out)
    if pairs is not None:
        chosen = override_pairs(chosen, os.fspath(pairs), hold_out)
    if steps is not None:
        chosen = override_training(chosen, steps=steps)
    train_run(
        TrainingRun(
            recipe=chosen,
            folder=folder,
            resume=True,
            max_minutes=minutes,
            n_workers=workers,
            command="tactoscope.train",
        )
    )
    weights = folder / "weights.safetensors"
    export_run(folder, weights)
    return weights


# common names: another package of one may come first on the import path
_PACKAGES = ("app", "widgets", "pipeline")


def main() -> None:
    """Run the `tactoscope` command.

    Exits with 2 and a message if another package shadows one of this project's.
    """
    here = Path(__file__).resolve().parent
    for name in _PACKAGES:
        found = _find_location(importlib.util.find_spec(name))
        if found != here / name:
            sys.stderr.write(
                f"tactoscope: another package named {name!r} shadows this project's; remove it "
                "from PYTHONPATH, or "
                f"install Tactoscope in its own environment: '{found}'\n"
            )
            sys.exit(2)
    from app.command import main as run

    run()


def _find_location(spec: ModuleSpec | None) -> Path | None:
    """Return the folder of a package, or the file of a module."""
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).resolve()
    return None if spec.origin is None else Path(spec.origin).resolve()


if __name__ == "__main__":
    main()
