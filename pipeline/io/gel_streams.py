"""Streams of a gel's images that are read one by one: folders, arrays and videos, and containers of
several cameras, of which those that record touch are chosen by their names.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import cast

import numpy as np

from pipeline.core.arrays import Doubles, Image, Stored, describe_size, freeze
from pipeline.core.errors import FileProblem, SettingProblem, escape_text
from pipeline.core.frozen import frozen
from pipeline.core.values.frames import Stream, TactileFrame
from pipeline.io import image_files
from pipeline.io.formats import ReadOptions, with_index_check
from pipeline.io.gel_images import (
    GelImageConverter,
    estimate_no_change_grey,
    make_gel_converter,
    require_colour,
)
from pipeline.io.reference_images import find_first_reference, read_each, sample_frames
from pipeline.io.resampling import fit_resampling
from pipeline.io.sensor_guess import find_named_sensor, resolve_sensor_name
from pipeline.sensors.spec import SensorSpec, load_sensor

# frames that show whether a stream is in colour, and whose size is compared with the reference's
_N_COLOUR = 3
_N_FIRST = 3
# A word for touch: "tactile_left", "leftTactile", "digit2", "gelsight", "finger"; not "digital",
# "angel", "touchscreen" or "finger_joint".
_TOUCH = re.compile(
    r"(?i:tactile|haptic|gelsight|gelslim|finger(?!_?joint))"
    r"|(?:(?<![A-Za-z])(?i:touch|digit|gel|bubble)|(?<=[a-z])(?:Touch|Digit|Gel|Bubble))"
    r"(?!(?i:screen|pad|al|ise|ize|ato))"
)


@frozen
class ImageSource:
    """Stored images of one sensor."""

    n_frames: int
    # (rows, cols, 3): bytes, or a signed difference in grey levels; raises FileProblem
    read: Callable[[int], Stored]
    origin: Callable[[int], str] = str  # file and frame, where all are in one
    times_s: Doubles | None = None
    files: Sequence[Path] = ()  # one a frame; () = all are in one
    is_film: bool = False  # whether it begins untouched, so that a frame of it is the reference
    notes: tuple[str, ...] = ()  # on how it is read


def make_gel_stream(
    source: ImageSource,
    path: Path,
    options: ReadOptions,
    *,
    name: str,
    reference: Image | None = None,
    reference_file: Path | None = None,
    about: tuple[str, ...] = (),
    may_guess: bool = True,
) -> tuple[Stream, tuple[str, ...]]:
    """The stream of a source, and notes.

    The reference is the stated file, else `reference`, with the notes `about` it. Without any,
    differences imply it, else it is made of the first frames
    (`reference_images.find_first_reference`). Without
    `may_guess` a sensor that is not stated stays unknown. Raises FileProblem for a first frame that
    cannot be decoded, or a reference of another size.
    """
    # one damaged file of a folder, or one of another size, does not hide the others
    readable = read_each(source.read, range(1 if source.is_film else source.n_frames))
    firsts = [image for _, image in islice(readable, _N_FIRST)] or [source.read(0)]
    if options.reference is not None:
        reference = image_files.read_rgb(options.reference)
        about = (f"{options.reference.name} is the reference",)
    first = next((i for i in firsts if reference is None or i.shape == reference.shape), firsts[0])
    size = describe_size(first.shape)

    def read(index: int) -> Stored:
        image = source.read(index)
        if image.shape != first.shape:
            raise FileProblem(
                f"frame {index} is {describe_size(image.shape)}, the others are {size}",
                source.files[index] if source.files else path,
            )
        return image

    def name_frame(index: int) -> str:
        return escape_text(source.files[index].name) if source.files else f"frame {index}"

    if reference is not None and reference.shape != first.shape:
        raise FileProblem(
            f"the reference image is {describe_size(reference.shape)}, the others are {size}; "
            "give one of that size as --reference",
            options.reference or reference_file or path,
        )
    if first.dtype == np.uint8:
        read_image = cast("Callable[[int], Image]", read)
        require_colour((i for _, i in sample_frames(read_image, source.n_frames, _N_COLOUR)), path)
        if reference is None and estimate_no_change_grey(np.asarray(first, np.uint8)) is None:
            reference, note = find_first_reference(
                read_image, source.n_frames, name_frame, is_film=source.is_film
            )
            about = (note or image_files.NO_REFERENCE_NOTE,)
    if options.sensor or may_guess:
        converter = make_gel_converter(
            options.sensor,
            (first.shape[0], first.shape[1]),
            reference,
            lambda: first,
            file_names=[file.stem for file in source.files] or (name,),
        )
    else:
        note = (
            f"{name} names no sensor of touch; if it is one, say which with --stream {name} "
            "--sensor NAME"
        )
        converter = GelImageConverter(sensor="", reference=reference, notes=(note,))
    notes = converter.notes + source.notes
    named = find_named_sensor((name,))
    if options.sensor and named not in ("", converter.sensor):
        notes = (f"{name} names the sensor {named}; {converter.sensor} is used instead", *notes)

    def frame(index: int) -> TactileFrame:
        time_s = math.nan if source.times_s is None else float(source.times_s[index])
        origin = str(source.files[index]) if source.files else source.origin(index)
        return converter.make_frame(read(index), index, origin, time_s)

    stream = Stream(
        name=name or converter.sensor or ("video" if source.is_film else "images"),
        sensor=converter.sensor,
        n_frames=source.n_frames,
        frame=with_index_check(frame, source.n_frames, path),
        times_s=source.times_s,
    )
    return stream, (*notes, *(about if converter.no_change_grey is None else ()))


def make_film(
    path: Path, n_frames: int, read: Callable[[int], Image], times_s: Doubles
) -> ImageSource:
    """The images of a video, topic or camera, which begins untouched."""
    return ImageSource(
        n_frames=n_frames,
        read=read,
        origin=lambda index: f"{path} [frame {index}]",
        times_s=freeze(times_s),
        is_film=True,
    )


def names_touch(name: str) -> bool:
    """Whether the name of a topic or camera says that it records touch, or names a described
    sensor.
    """
    return bool(_TOUCH.search(name)) or bool(find_named_sensor((name,)))


def make_streams(
    cameras: Mapping[str, Callable[[], ImageSource]], path: Path, options: ReadOptions
) -> tuple[tuple[Stream, ...], tuple[str, ...]]:
    """The streams of a container's cameras that record touch, and notes.

    The one that the user names in any case.

    Where no name says so, all are streams, but their sensor is not guessed. A stated sensor names
    the only camera, the stream that the user names, and those that name no sensor and have its
    size. A camera that cannot be read is left out; raises its FileProblem where none can, and
    SettingProblem for a reference where several can.
    """
    tactile = [name for name in cameras if names_touch(name)]
    asked = options.stream.strip("/")
    chosen = [name for name in cameras if not tactile or name in tactile or name == asked]
    problems = dict[str, FileProblem]()
    opened = dict[str, ImageSource]()
    shapes = dict[str, tuple[int, ...]]()
    for name in chosen:
        try:
            source = cameras[name]()
            shapes[name] = source.read(0).shape[:2]
            opened[name] = source
        except FileProblem as problem:
            problems[name] = problem
    if options.reference is not None and len(opened) > 1 and asked not in opened:
        raise SettingProblem(
            "a reference can be given for one camera; choose it with --stream "
            f"({', '.join(opened)}): '{path}'"
        )
    stated = _select_stated(shapes, options, is_only=len(cameras) == 1)
    streams = list[Stream]()
    notes = list[str]()
    for name, source in opened.items():
        try:
            own = replace(
                options,
                sensor=options.sensor if name in stated else "",
                reference=options.reference if asked in ("", name) else None,
            )
            stream, about = make_gel_stream(
                source, path, own, name=name, may_guess=names_touch(name)
            )
        except FileProblem as problem:
            problems[name] = problem
            continue
        streams.append(stream)
        notes += about
    if problems and not streams:
        raise next(iter(problems.values()))
    left_out = [name for name in cameras if name not in chosen]
    if left_out:
        notes.append(f"cameras without touch are left out: {', '.join(left_out)}")
    notes += [f"{name} is left out: {problem}" for name, problem in problems.items()]
    return tuple(streams), tuple(dict.fromkeys(notes))


def _select_stated(
    shapes: Mapping[str, tuple[int, ...]], options: ReadOptions, *, is_only: bool
) -> list[str]:
    """Names of the streams (of images of these shapes) that the stated sensor is about."""
    asked = options.stream.strip("/")
    if not options.sensor:
        return []
    if is_only or asked in shapes:
        return [name for name in shapes if asked in ("", name)]
    spec = load_sensor(options.sensor)
    fitting = [name for name, shape in shapes.items() if _may_be(spec, name, shape)]
    if len(fitting) > 1 and not any(map(names_touch, fitting)):
        return []  # cameras of one size, none of which names touch: the user has to name the stream
    return fitting


def _may_be(spec: SensorSpec, name: str, shape: tuple[int, ...]) -> bool:
    """Whether a camera names the sensor, or names none and has its size."""
    rows, cols = shape
    named = find_named_sensor((name,))
    if named:
        return named == spec.name
    guess, _ = resolve_sensor_name("", (rows, cols), is_depth=False)
    if guess:
        return guess == spec.name or shape == spec.camera.shape
    fit = fit_resampling(spec, (rows, cols))
    return shape == spec.camera.shape or (fit is not None and not fit.is_rotated)
