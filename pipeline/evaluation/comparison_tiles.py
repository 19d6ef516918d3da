"""What a comparison shows, and the same as a folder of pictures and numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem
from pipeline.base.files import open_atomic, write_folder, write_json
from pipeline.previews.layers import Layer
from pipeline.previews.tile import Tile
from pipeline.translation.translate import Translation

TABLE_FILE = "compare.json"
_NO_LETTERS = re.compile(r"[^a-z0-9]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonTiles:
    """The tiles so far, and a sentence."""

    tiles: tuple[Tile, ...]
    summary: str
    reliability_curve: tuple[tuple[float, float], ...] = ()  # spread and error, mm
    stage: str = ""  # that is also shown in 3D,
    views_3d: tuple[tuple[tuple[Layer, ...], Translation | None], ...] = ()  # from where it is seen in each


TilesCallback = Callable[[ComparisonTiles], object]


def ignore_tiles(_: ComparisonTiles) -> None:
    """Where nobody looks at what is done so far."""


def write_tiles(folder: Path, tiles: Sequence[Tile]) -> None:
    """Each tile's picture, and its difference to the truth, as PNG at its own size; the figures in `compare.json`.

    The same tiles give the same bytes: times are left out. Raises FileProblem.
    """
    if folder.exists() and not (folder / TABLE_FILE).exists():
        raise FileProblem("something else than a comparison is there; choose another folder", folder)

    def fill(part: Path) -> None:
        told: list[object] = []
        for index, tile in enumerate(tiles):
            name = f"{index:02d}_{_NO_LETTERS.sub('_', tile.title.casefold()).strip('_')}"
            pictures = {"": tile.preview, "_difference": tile.difference}
            made = {f"{name}{end}.png": picture for end, picture in pictures.items() if picture is not None}
            for file, picture in made.items():
                with open_atomic(part / file, "the picture") as png:
                    png.write(_png(picture.pixels))
            told.append(
                {"title": tile.title, "problem": tile.problem, "figures": dict(tile.metrics), "pictures": list(made)}
            )
        write_json(part / TABLE_FILE, {"tiles": told}, "the comparison")

    write_folder(folder, fill)


def _png(pixels: Image) -> bytes:
    import cv2

    _, png = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))
    return png.tobytes()
