"""A comparison of variants as tiles, and the same as a folder of images and metrics."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.core.arrays import Image
from pipeline.core.files import check_folder, open_atomic, require_own, write_folder, write_json
from pipeline.core.frozen import frozen
from pipeline.io.image_files import read_rgb
from pipeline.views.preview import Tile

TABLE_FILE = "compare.json"
_NON_ALPHANUMERIC = re.compile(r"[^a-z0-9]+")


@frozen
class Comparison:
    """The tiles computed so far, and a summary sentence."""

    tiles: tuple[Tile, ...]
    summary: str


def write_tiles(folder: Path, tiles: Sequence[Tile]) -> None:
    """Write each tile's image and its difference to ground truth as PNG at full size, and the
    metrics as JSON.

    The same tiles give the same bytes: times are left out. Raises FileProblem.
    """

    def fill(part: Path) -> None:
        entries: list[object] = []
        for index, tile in enumerate(tiles):
            name = f"{index:02d}_{_NON_ALPHANUMERIC.sub('_', tile.title.casefold()).strip('_')}"
            previews = {f"{name}.png": tile.preview, f"{name}_difference.png": tile.difference}
            images = {
                file: preview.pixels for file, preview in previews.items() if preview is not None
            }
            for file, pixels in images.items():
                with open_atomic(part / file, "the image", read_rgb) as png:
                    png.write(_encode_png(pixels))
            entries.append(
                {
                    "title": tile.title,
                    "problem": tile.problem,
                    "metrics": dict(tile.metrics),
                    "images": list(images),
                }
            )
        write_json(part / TABLE_FILE, {"tiles": entries}, "the comparison")

    write_folder(folder, fill, _list_own_files(folder))


def check_tiles_folder(folder: Path) -> None:
    """Make sure that tiles can be written to `folder`, before long work; raises FileProblem."""
    require_own(folder, _list_own_files(folder))
    check_folder(folder.parent)


def _list_own_files(folder: Path) -> tuple[str, ...]:
    return (TABLE_FILE, *sorted(entry.name for entry in folder.glob("[0-9][0-9]_*.png")))


def _encode_png(pixels: Image) -> bytes:
    import cv2

    _, png = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))
    return png.tobytes()
