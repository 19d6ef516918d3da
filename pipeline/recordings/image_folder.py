"""Read gel images with a reference image among them: a folder, one image, or the tree of a data set."""

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem, escape_text
from pipeline.recordings import image_files
from pipeline.recordings.formats import ReadOptions, RecordingFiles, with_index_check
from pipeline.recordings.gel_images import estimate_no_change_grey, make_gel_converter
from pipeline.recordings.reference_images import denoise_reference, select_reference_frame
from pipeline.values.frames import Recording, Stream, TactileFrame

_N_COMPARED = 3  # images whose size is compared with the reference's
_N_CANDIDATES = 16  # images that are compared with the first ones, whether these show contact


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """The images as one stream of RGB frames, in order.

    The reference is the stated file, else the first image named background*, bg*, ref*, reference*, untouched* or
    undeformed*, as the median with the first frames where they are alike. Differences imply it; without any it is the
    median of the first frames, if at least three are alike and untouched, else there is none; a note says which. Images
    of the sensor at another size are resampled, grey ones among colour ones left out. Raises FileProblem or
    SettingProblem.
    """
    path = files.path
    reference_file = options.reference or (files.references[0] if files.references else None)
    references = (*files.references, *((reference_file,) if reference_file else ()))
    excluded = {os.path.realpath(p) for p in references}
    images = [p for p in files.images if os.path.realpath(p) not in excluded]
    images, notes = select_colour_series(images)
    if not images:
        raise FileProblem(
            "the folder has no images to show" if path.is_dir() else "the only image is the reference", path
        )
    reference = None if reference_file is None else image_files.read_rgb(reference_file)
    shape = (_read_first(images) if reference is None else reference).shape
    if reference_file is not None and not _has_shape(images[:_N_COMPARED], shape):
        other = _read_first(images).shape
        raise FileProblem(
            f"the reference image is {shape[1]} x {shape[0]} px, the others are {other[1]} x {other[0]} px; give one "
            "of that size as --reference",
            reference_file,
        )
    n_averaged = 0
    if reference is not None and options.reference is None:
        reference, n_averaged = denoise_reference(reference, _read_all(images))
    elif reference is None:
        reference, n_averaged = _take_first_frames(images, shape)
    names = [p.stem for p in images]
    converter = make_gel_converter(
        options.sensor, (shape[0], shape[1]), reference, lambda: _read_first(images), file_names=names
    )

    def frame(index: int) -> TactileFrame:
        image = converter.convert_image(_read_of_shape(images[index], shape, index))
        return TactileFrame(sensor=converter.sensor, image=image, reference=converter.reference, index=index,
                            origin=str(images[index]))  # fmt: skip

    stream = Stream(name=converter.sensor or "images", sensor=converter.sensor, n_frames=len(images),
                    frame=with_index_check(frame, len(images), path))  # fmt: skip
    about = () if converter.implied_reference is not None else _describe_reference(reference_file, files, n_averaged)
    return Recording(path=path, format="folder of images" if path.is_dir() else "image",
                     streams=(stream,), notes=(*files.notes, *notes, *converter.notes, *about))  # fmt: skip


def _read_first(images: list[Path]) -> Image:
    """The first image that can be read, so that one damaged file does not hide the others."""
    problem: FileProblem | None = None
    for file in images:
        try:
            return image_files.read_rgb(file)
        except FileProblem as error:
            problem = problem or error
    assert problem is not None
    raise problem


def _take_first_frames(images: list[Path], shape: tuple[int, ...]) -> tuple[Image | None, int]:
    """(reference, number of frames averaged) of a sequence that begins untouched; (None, 0) where it may not.

    Its first frames are alike, and no later frame has clearly less contact. Differences have no frame as reference.
    """
    frames = (image for image in _read_all(images) if image.shape == shape)
    first = next(frames, None)
    if first is None or estimate_no_change_grey(first) is not None:
        return None, 0
    reference, n_averaged = denoise_reference(first, frames)
    later = images[n_averaged + 1 :: max(1, len(images) // _N_CANDIDATES)]
    is_touched = n_averaged and select_reference_frame(reference, enumerate(_read_all(later))) is not None
    return (reference, n_averaged) if n_averaged and not is_touched else (None, 0)


def _has_shape(images: list[Path], shape: tuple[int, ...]) -> bool:
    """Whether one of the images has this shape; True if none can be read."""
    shapes = [image.shape for image in _read_all(images)]
    return not shapes or shape in shapes


def _read_of_shape(file: Path, shape: tuple[int, ...], index: int) -> Image:
    try:
        image = image_files.read_rgb(file)
    except FileProblem as error:
        error.field = f"frame {index}"
        raise
    if image.shape != shape:
        raise FileProblem(
            f"frame {index} is {image.shape[1]} x {image.shape[0]} px, the others are {shape[1]} x {shape[0]} px",
            file,
            field=f"frame {index}",
        )
    return image


def _read_all(images: Sequence[Path]) -> Iterator[Image]:
    """The images up to the first that cannot be read."""
    try:
        for file in images:
            yield image_files.read_rgb(file)
    except FileProblem:
        return


def _describe_reference(reference: Path | None, files: RecordingFiles, n_averaged: int) -> tuple[str, ...]:
    if reference is None:
        if n_averaged:
            return (f"the median of the first {n_averaged + 1} images, all alike, is taken as the reference",)
        return (image_files.NO_REFERENCE_NOTE,)
    unused = [p.name for p in files.references if p != reference]
    more = (f"other reference images are left out: {', '.join(unused)}",) if unused else ()
    alike = f", as the median with the first {n_averaged} frames" if n_averaged else ""
    return (f"{reference.name} is the reference{alike}", *more)


_PATTERN = re.compile(r"^(\D*)(?:\d.*\d|\d)?(\D*)$", re.DOTALL)  # words before the first digit and after the last one
_MAX_SERIES = 32  # more patterns than these are names of their own


def select_colour_series(images: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """(images, notes): the images without the grey series, where some series are grey and others in colour.

    Data sets keep what was derived from an image next to it: depth maps, masks, the other sensor's imprint. These are
    grey, and a gel's camera records colour. Images of one name pattern (`touch_007`, `07_gelslim`) are of one kind, so
    that one image of each is read.
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


def _is_grey(file: Path) -> bool:
    """Whether an image has one channel, or three equal ones; a damaged image counts as colour."""
    try:
        pixels = image_files.read_raw_pixels(file)
    except FileProblem:
        return False
    return pixels.ndim == 2 or bool((pixels[..., :1] == pixels[..., :3]).all())
