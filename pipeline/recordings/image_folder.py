"""Images with a picture of the untouched sensor beside them: a folder, one image, or a data set's own tree."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem
from pipeline.recordings import image_files
from pipeline.recordings.folder_contents import FolderContent
from pipeline.recordings.gel_images import make_gel_converter
from pipeline.recordings.index_check import with_index_check
from pipeline.recordings.reference_denoising import denoise_reference
from pipeline.values.frames import Recording, Stream, TactileFrame

_LOOKED_AT = 3  # images whose size is compared with the reference's


def read(path: Path, found: FolderContent, *, sensor: str = "", reference: Path | None = None) -> Recording:
    """The images of a folder (or one image) as one stream of RGB frames, in the order found.

    The reference is the file given, else the first one named background*, bg*, ref*, reference*, untouched* or
    undeformed*, or its median with the first frames where they show the same; differences from it imply it; without
    any the frames have none, and the notes say so. Pictures of the right sensor at another size are resampled.
    Raises FileProblem or SettingProblem.
    """
    chosen = reference or (found.references[0] if found.references else None)
    left_out = {os.path.realpath(p) for p in (*found.references, *((chosen,) if chosen else ()))}
    files = [p for p in found.images if os.path.realpath(p) not in left_out]
    if not files:
        raise FileProblem(
            "the folder has no images to show" if path.is_dir() else "the only image is the reference", path
        )
    untouched = None if chosen is None else image_files.read_rgb(chosen)
    shape = (_first(files) if untouched is None else untouched).shape
    if chosen is not None and not _any_of_shape(files, shape):
        other = _first(files).shape
        raise FileProblem(f"the picture of the untouched sensor is {shape[1]} x {shape[0]} px, the others are "
                          f"{other[1]} x {other[0]} px; give one of that size as --reference", chosen)  # fmt: skip
    steadier = 0
    if untouched is not None and reference is None:
        untouched, steadier = denoise_reference(untouched, _readable(files))
    made = make_gel_converter(sensor, (shape[0], shape[1]), untouched, lambda: _first(files))

    def frame(index: int) -> TactileFrame:
        image = made.convert_image(_of_shape(files[index], shape, index))
        return TactileFrame(sensor=made.sensor, image=image, reference=made.reference, index=index,
                            origin=str(files[index]))  # fmt: skip

    stream = Stream(name=made.sensor or "images", sensor=made.sensor, n_frames=len(files),
                    frame=with_index_check(frame, len(files), path))  # fmt: skip
    about = () if made.implied_reference is not None else _about(chosen, found.references, steadier)
    return Recording(path=path, format="folder of images" if path.is_dir() else "image",
                     streams=(stream,), notes=found.notes + made.notes + about)  # fmt: skip


def _first(files: list[Path]) -> Image:
    """The first image that can be read, so that one damaged file does not hide the others."""
    problem: FileProblem | None = None
    for file in files:
        try:
            return image_files.read_rgb(file)
        except FileProblem as error:
            problem = problem or error
    assert problem is not None
    raise problem


def _any_of_shape(files: list[Path], shape: tuple[int, ...]) -> bool:
    """Whether one of the first images that can be read has this shape; true where none of them can."""
    other = False
    for image in _readable(files[:_LOOKED_AT]):
        if image.shape == shape:
            return True
        other = True
    return not other


def _of_shape(file: Path, shape: tuple[int, ...], index: int) -> Image:
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


def _readable(files: list[Path]) -> Iterator[Image]:
    """The images up to the first that cannot be read."""
    try:
        for file in files:
            yield image_files.read_rgb(file)
    except FileProblem:
        return


def _about(chosen: Path | None, named: tuple[Path, ...], steadier: int) -> tuple[str, ...]:
    if chosen is None:
        return ("no picture of the untouched sensor was found; name one with --reference",)
    unused = [p.name for p in named if p != chosen]
    more = (f"other pictures of the untouched sensor are left out: {', '.join(unused)}",) if unused else ()
    alike = f", as do the first {steadier} frames: their median is the reference" if steadier else ""
    return (f"{chosen.name} shows the untouched sensor{alike}", *more)
