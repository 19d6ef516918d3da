"""A folder of images with a picture of the untouched sensor beside them."""

from __future__ import annotations

import os
from pathlib import Path

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem
from pipeline.recordings import pictures
from pipeline.recordings.indexing import checked_index
from pipeline.recordings.sensor_guess import named_or_guessed
from pipeline.values.frames import Recording, Stream, TactileFrame


def read(path: Path, *, sensor: str = "", reference: Path | None = None) -> Recording:
    """The images of a folder (or one image) as one stream of RGB frames in natural order of their names.

    The reference is the file given, else the first one named background*, bg*, ref*, reference*, untouched* or
    undeformed*; without one the frames have none, and the notes say so. Raises FileProblem or SettingProblem.
    """
    every = [path] if path.is_file() else sorted(filter(pictures.is_picture, path.iterdir()), key=pictures.natural_key)
    named = [p for p in every if pictures.is_reference(p)] if path.is_dir() else []
    chosen = reference or (named[0] if named else None)
    left_out = {os.path.realpath(p) for p in (*named, *((chosen,) if chosen else ()))}
    files = [p for p in every if os.path.realpath(p) not in left_out]
    if not files:
        raise FileProblem(
            "the folder has no images to show" if path.is_dir() else "the only image is the reference", path
        )
    untouched = None if chosen is None else pictures.rgb(chosen)
    shape = _first_shape(files) if untouched is None else untouched.shape
    name, notes = named_or_guessed(sensor, (shape[0], shape[1]), is_depth=False)

    def frame(index: int) -> TactileFrame:
        image = _of_shape(files[index], shape, index)
        return TactileFrame(sensor=name, image=image, reference=untouched, index=index, origin=str(files[index]))

    stream = Stream(name=name or "images", sensor=name, n_frames=len(files),
                    frame=checked_index(frame, len(files), path))  # fmt: skip
    return Recording(path=path, format="folder of images" if path.is_dir() else "image",
                     streams=(stream,), notes=notes + _about(chosen, named))  # fmt: skip


def _first_shape(files: list[Path]) -> tuple[int, ...]:
    """Of the first image that can be read, so that one damaged file does not hide the others."""
    problem: FileProblem | None = None
    for file in files:
        try:
            return pictures.rgb(file).shape
        except FileProblem as error:
            problem = problem or error
    assert problem is not None
    raise problem


def _of_shape(file: Path, shape: tuple[int, ...], index: int) -> Image:
    try:
        image = pictures.rgb(file)
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


def _about(chosen: Path | None, named: list[Path]) -> tuple[str, ...]:
    if chosen is None:
        return ("no picture of the untouched sensor was found; name one with --reference",)
    unused = [p.name for p in named if p != chosen]
    more = (f"other pictures of the untouched sensor are left out: {', '.join(unused)}",) if unused else ()
    return (f"{chosen.name} shows the untouched sensor", *more)
