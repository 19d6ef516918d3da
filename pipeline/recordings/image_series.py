"""Which images of a folder are a gel's, where it holds several series of one name pattern each.

Data sets keep what was derived from an image next to it: depth maps, masks, the other sensor's imprint. These are grey,
and a gel's camera records colour. Images of one name pattern (`touch_007`, `07_gelslim`) are of one kind, so that one
image of each is read.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from pipeline.base.errors import FileProblem
from pipeline.base.text import escape_text
from pipeline.recordings import image_files

_PATTERN = re.compile(r"^(\D*)(?:\d.*\d|\d)?(\D*)$", re.DOTALL)  # words before the first digit and after the last one
_MAX_SERIES = 32  # more patterns than these are names of their own


def select_colour_series(images: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """(images, notes): the images without the grey series, where some series are grey and others in colour."""
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
