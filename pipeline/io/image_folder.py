"""Read gel images with a reference image among them: a folder, one image, or the tree of a data
set.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image
from pipeline.core.errors import FileProblem, SettingProblem, escape_text
from pipeline.core.values.frames import Recording, Stream, TactileFrame
from pipeline.io import file_names, image_files
from pipeline.io.formats import ReadOptions, RecordingFiles, with_index_check
from pipeline.io.gel_streams import ImageSource, make_gel_stream
from pipeline.io.reference_images import (
    compute_block_means,
    denoise_reference,
    read_until_damaged,
    sample_frames,
)

_N_LIGHT = 9  # images of a series whose median is its light
# median change between the light of two sensors; times that within a series
_LIGHT_GREY = 6.0
_LIGHT_RATIO = 3.0


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """The images as one stream of RGB frames, in order.

    One stream a sensor where the names tell several apart.

    The reference is the stated file, else the first image named background*, bg*, ref*, reference*,
    untouched* or undeformed*, as the median with the first frames where they are alike. Differences
    imply it; without any it is the median of the first frames, if at least three are alike and
    untouched, else there is none; a note says which. Images of the sensor at another size are
    resampled, grey ones among colour ones left out. Raises FileProblem or SettingProblem.
    """
    path = files.path
    excluded = {
        os.path.realpath(p)
        for p in (*files.references, *((options.reference,) if options.reference else ()))
    }
    images = [p for p in files.images if os.path.realpath(p) not in excluded]
    found = images
    images, notes = select_colour_series(found)
    if not images:
        raise FileProblem(
            "the folder has no images to show"
            if path.is_dir()
            else "the only image is the reference",
            path,
        )
    groups = file_names.split_sensors(images) if path.is_dir() else {}
    if not groups:
        _require_one_light(file_names.find_subseries(images), path)
        times_s = file_names.parse_times_s(images)
        stream, about = _read_series("", images, files.references, path, options, times_s)
        grey = set(found).difference(images)
        partners = _find_partners(images, grey)
        streams = (stream, *partners)
        notes = () if partners and len(partners) * len(images) == len(grey) else notes
    else:
        asked = options.stream if options.stream in groups else ""
        if options.reference is not None and not asked:
            raise SettingProblem(
                "a reference can be given for one sensor, and the names of the images tell "
                f"{len(groups)} apart "
                f"({', '.join(groups)}): choose one with --stream, or name the references "
                f"{', '.join(f'background_{name}' for name in groups)}"
            )
        times = file_names.parse_series_times_s(groups)
        paired = groups if times else file_names.select_common_numbers(groups)
        n_alone = len(images) - sum(map(len, paired.values()))
        made = [
            _read_series(
                name,
                paired[name],
                _select_references(name, groups, files.references),
                path,
                options if name == asked else replace(options, reference=None),
                times.get(name),
            )
            for name in groups
        ]
        streams = tuple(stream for stream, _ in made)
        about = tuple(f"{stream.name}: {note}" for stream, own in made for note in own)
        notes += (f"the names of the images tell {len(groups)} sensors apart: {', '.join(groups)}",)
        notes += (
            f"{n_alone} images without one of the same number of the other sensor are left out",
        ) * (n_alone > 0)
    return Recording(
        path=path,
        format="folder of images" if path.is_dir() else "image",
        streams=streams,
        notes=(*notes, *about),
    )


def _read_series(
    name: str,
    images: list[Path],
    references: Sequence[Path],
    path: Path,
    options: ReadOptions,
    times_s: Doubles | None,
) -> tuple[Stream, tuple[str, ...]]:
    """The images of one sensor as a stream, and notes.

    `name` tells it from others, "" where it is alone.
    """

    def read_raw(index: int) -> Image:
        return image_files.read_rgb(images[index])

    file = None if options.reference else next(iter(references), None)
    reference = None
    about = tuple[str, ...]()
    if file is not None:
        reference, n_averaged = denoise_reference(
            image_files.read_rgb(file), read_until_damaged(image_files.read_rgb, images)
        )
        alike = f", as the median with the first {n_averaged} frames" if n_averaged else ""
        about = (f"{file.name} is the reference{alike}",)
        if len(references) > 1:
            others = ", ".join(p.name for p in references if p != file)
            about += (f"other reference images are left out: {others}",)
    source = ImageSource(
        n_frames=len(images),
        read=read_raw,
        files=images,
        times_s=times_s,
        notes=() if times_s is None else ("the times are those in the names of the files",),
    )
    return make_gel_stream(
        source, path, options, name=name, reference=reference, reference_file=file, about=about
    )


def _select_references(
    name: str, sensors: Mapping[str, object], references: Sequence[Path]
) -> list[Path]:
    """The reference images of one sensor: those with its name."""
    words = {file: set(re.findall(r"[a-z]+|\d+", file.stem.lower())) for file in references}
    return [file for file, own in words.items() if own.intersection(sensors) == {name}]


def _require_one_light(series: Mapping[str, list[Path]], path: Path) -> None:
    """Raise FileProblem where series of names differ in size or light, as those of two sensors
    do.
    """
    lights = dict[str, tuple[Floats, float]]()
    for name, files in series.items():
        found = [image for _, image in sample_frames(_make_reader(files), len(files), _N_LIGHT)]
        shapes = {image.shape for image in found}
        if len(shapes) != 1:
            continue
        blocks = np.stack([compute_block_means(image, 16) for image in found])
        light = np.median(blocks, axis=0)
        lights[name] = light, float(np.median(np.abs(blocks - light)))
    first, *others = lights.items() or [("", (np.zeros(0), 0.0))]
    for name, (light, within) in others:
        differs = light.shape != first[1][0].shape
        change = np.inf if differs else float(np.median(np.abs(light - first[1][0])))
        if change > max(_LIGHT_GREY, _LIGHT_RATIO * max(within, first[1][1])):
            raise FileProblem(
                f"the images named {first[0]} and {name} differ in "
                f"{'size' if differs else 'light'} as those of two "
                "sensors do; put those of each into a folder of its own, or name them left and "
                "right",
                path,
            )


def _make_reader(files: Sequence[Path]) -> Callable[[int], Image]:
    return lambda index: image_files.read_rgb(files[index])


# words before the first digit and after the last one
_PATTERN = re.compile(r"^(\D*)(?:\d.*\d|\d)?(\D*)$", re.DOTALL)
_PARTNER = re.compile(r"_(bubble|gelslim|digit|mini)(_|$)")  # in what follows the name of a touch
_MAX_SERIES = 32  # more patterns than these are names of their own


def select_colour_series(images: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """(images, notes): the images without the grey series, where some series are grey and others in
    colour.

    Data sets keep what was derived from an image next to it: depth maps, masks, the other sensor's
    imprint. These are grey, and a gel's camera records colour. Images of one name pattern
    (`touch_007`, `07_gelslim`) are of one kind, so that one image of each is read.
    """
    series: dict[tuple[str, ...], list[Path]] = {}
    for image in images:
        found = _PATTERN.match(image.stem)
        series.setdefault(found.groups() if found else (), []).append(image)
    if not 1 < len(series) <= _MAX_SERIES or all(len(members) == 1 for members in series.values()):
        return list(images), ()
    grey = [members for members in series.values() if _is_grey(members[0])]
    left_out = {image for members in grey for image in members}
    if not left_out or len(grey) == len(series):
        return list(images), ()
    name = escape_text(grey[0][0].name)
    note = f"{len(left_out)} grey images such as {name} are left out: a gel's camera records colour"
    return [image for image in images if image not in left_out], (note,)


def _find_partners(images: Sequence[Path], grey: set[Path]) -> list[Stream]:
    """Grey images whose names end in another sensor's, one for every image: its partners,
    without millimetres.
    """
    touches = [image.stem.removesuffix(_find_ending(images[0])) for image in images]
    partners: list[Stream] = []
    for name in {_find_ending(file) for file in grey}:
        files = [
            image.with_name(f"{touch}{name}{image.suffix}")
            for image, touch in zip(images, touches, strict=True)
        ]
        sensor = _PARTNER.search(name)
        if sensor and grey.issuperset(files):
            partners.append(_make_partner(name[sensor.start() :].strip("_"), files))
    return sorted(partners, key=lambda stream: stream.name)


def _find_ending(file: Path) -> str:
    found = _PATTERN.match(file.stem)
    return found[2] if found else ""


def _make_partner(name: str, files: Sequence[Path]) -> Stream:
    def frame(index: int) -> TactileFrame:
        image = image_files.read_rgb(files[index])
        return TactileFrame(
            sensor="", image=image, reference=None, index=index, origin=str(files[index])
        )

    return Stream(
        name=name,
        sensor="",
        n_frames=len(files),
        frame=with_index_check(frame, len(files), files[0].parent),
    )


def _is_grey(file: Path) -> bool:
    """Whether an image has one channel, or three equal ones; a damaged image counts as colour."""
    try:
        pixels = image_files.read_raw_pixels(file)
    except FileProblem:
        return False
    return pixels.ndim == 2 or bool((pixels[..., :1] == pixels[..., :3]).all())
