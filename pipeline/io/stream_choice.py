"""Streams of a container that holds several cameras: which record touch, and which of them a
stated sensor is about.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.core.errors import FileProblem
from pipeline.core.values.frames import Stream
from pipeline.io.formats import ReadOptions
from pipeline.io.image_sequence import ImageSequence, make_stream
from pipeline.io.resampling import fit_resampling
from pipeline.io.sensor_guess import find_named_sensor, resolve_sensor_name
from pipeline.sensors.spec import SensorSpec, load_sensor

# A word for touch: "tactile_left", "leftTactile", "digit2", "gelsight"; not "digital", "angel" or
# "touchscreen".
_TOUCH = re.compile(
    r"(?i:tactile|haptic|gelsight|gelslim)|(?:(?<![A-Za-z])(?i:touch|digit|gel|bubble)|(?<=[a-z])(?:Touch|Digit|Gel|Bubble))"
    r"(?!(?i:screen|pad|al|ise|ize|ato))"
)


def names_touch(name: str) -> bool:
    """Whether the name of a topic or camera says that it records touch, or names a described
    sensor.
    """
    return bool(_TOUCH.search(name)) or bool(find_named_sensor((name,)))


def make_streams(
    cameras: Mapping[str, Callable[[], ImageSequence]], path: Path, options: ReadOptions
) -> tuple[tuple[Stream, ...], tuple[str, ...]]:
    """The streams of a container's cameras that record touch, and notes.

    The one that the user names in any case.

    Where no name says so, all are streams, but their sensor is not guessed. A stated sensor names
    the only camera, the stream that the user names, and those that name no sensor and have its
    size. A camera that cannot be read is left out; raises its FileProblem where none can.
    """
    tactile = [name for name in cameras if names_touch(name)]
    asked = options.stream.strip("/")
    chosen = (
        [name for name in cameras if name in tactile or name == asked] if tactile else list(cameras)
    )
    streams = list[Stream]()
    notes = list[str]()
    problems = dict[str, FileProblem]()
    opened = dict[str, ImageSequence]()
    for name in chosen:
        try:
            opened[name] = cameras[name]()
            opened[name].frame(0)
        except FileProblem as problem:
            problems[name] = problem
            opened.pop(name, None)
    stated = _select_stated(opened, options, is_only=len(cameras) == 1)
    for name, images in opened.items():
        try:
            own = replace(
                options,
                sensor=options.sensor if name in stated else "",
                reference=options.reference if asked in ("", name) else None,
            )
            stream, about = make_stream(images, path, own, name=name, may_guess=names_touch(name))
        except FileProblem as problem:
            problems[name] = problem
            continue
        streams.append(stream)
        notes += about
    if problems and not streams:
        raise next(iter(problems.values()))
    left_out = [name for name in cameras if name not in chosen]
    notes += [f"cameras without touch are left out: {', '.join(left_out)}"] if left_out else []
    notes += [f"{name} is left out: {problem}" for name, problem in problems.items()]
    return tuple(streams), tuple(dict.fromkeys(notes))


def _select_stated(
    opened: Mapping[str, ImageSequence], options: ReadOptions, *, is_only: bool
) -> list[str]:
    """Names of the streams that the stated sensor is about."""
    asked = options.stream.strip("/")
    if not options.sensor or is_only or asked in opened:
        return [name for name in opened if asked in ("", name)] if options.sensor else []
    spec = load_sensor(options.sensor)
    fitting = [
        name for name, images in opened.items() if _may_be(spec, name, images.frame(0).shape[:2])
    ]
    if len(fitting) > 1 and not any(map(names_touch, fitting)):
        return []  # cameras of one size, none of which names touch: the user has to name the stream
    return fitting


def _may_be(spec: SensorSpec, name: str, shape: tuple[int, int]) -> bool:
    """Whether a camera names the sensor, or names none and has its size."""
    named = find_named_sensor((name,))
    if named:
        return named == spec.name
    guess, _ = resolve_sensor_name("", shape, is_depth=False)
    if guess:
        return guess == spec.name or shape == spec.camera.shape
    fit = fit_resampling(spec, shape)
    return shape == spec.camera.shape or (fit is not None and not fit.is_rotated)
