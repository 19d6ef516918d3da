"""Load imprint pairs from a folder of tiles, as training sets store them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.stage_warnings import StageWarning
from pipeline.imprints.difference_tiles import Ridges, detect_ridges
from pipeline.imprints.image_rotation import describe_orientation, orient_image
from pipeline.imprints.transfer import ImprintPair
from pipeline.inspection.synchrony import compare_signatures, compute_signature
from pipeline.recordings import image_files
from pipeline.sensors.spec import SensorSpec

_COMMON_SHARE = 0.8  # share of tiles with one orientation above which it is used for all
_TILE = (1.0, 1.0)  # width and height: the unit of tiles is the tile
SOURCE_TILES, TARGET_TILES = "*_gelslim.png", "*_bubble_gt.png"  # names of touch2touch's tiles
_MID_GREY, _GREY_TOLERANCE = 127.5, 45.0  # grey level of no change; published tiles: 112 to 165, altered ones 0 to 85
_MAX_NAMES = 5  # in a note


@dataclass(frozen=True, slots=True, kw_only=True)
class ImprintPairs:
    """Imprint pairs, and notes about them."""

    pairs: tuple[ImprintPair, ...]
    notes: tuple[str, ...]
    orientations: tuple[int, ...] = ()  # of tiles: `orient_image(tile, orientation)` is as the camera sees it


def is_tile_folder(path: Path) -> bool:
    """Whether a folder holds paired tiles by the names of touch2touch."""
    return path.is_dir() and all(next(path.glob(names), None) is not None for names in (SOURCE_TILES, TARGET_TILES))


def load_tile_pairs(folder: Path, source: SensorSpec, source_names: str, target_names: str) -> ImprintPairs:
    """Load images of `folder` whose names match both patterns (one `*` each, equal in a pair).

    A source's tile is a difference image, a target's a grey imprint. Rotated tiles are oriented by their own colours;
    the target's tile is rotated with its source's. Raises FileProblem where nothing is paired.
    """
    found = _match_names(folder, source_names), _match_names(folder, target_names)
    names = sorted(found[0].keys() & found[1].keys(), key=lambda n: image_files.natural_sort_key(Path(n)))
    if not names:
        raise FileProblem(f"no two images are named {source_names} and {target_names}", folder)
    images = {name: image_files.read_rgb(found[0][name]) for name in names}
    read = {name: detect_ridges(image, source) for name, image in images.items()}
    way, count = Counter(r.orientation for r in read.values()).most_common(1)[0]
    alike = count >= _COMMON_SHARE * len(names)
    if alike:
        read = {n: r if r.orientation == way else detect_ridges(images[n], source, way) for n, r in read.items()}
        note = f"the {source.name} tiles have one orientation: {describe_orientation(way)}"
    else:
        ways = len({r.orientation for r in read.values()})
        note = (
            f"the {source.name} tiles have {ways} orientations, estimated from colours; imprints are rotated with them"
        )
    clear = (
        float(np.median([r.curl_free for r in read.values()])),
        float(np.median([r.next_best for r in read.values()])),
    )
    clarity = f"slopes from colours are {clear[0]:.0%} integrable (next best orientation: {clear[1]:.0%})"
    pairs = tuple(_tiles(n, read[n], found[1][n]) for n in names)
    return ImprintPairs(
        pairs=pairs, notes=(note, clarity, *_describe_altered(images), *check_pairing(pairs)),
        orientations=tuple(read[name].orientation for name in names),
    )  # fmt: skip


def _describe_altered(images: Mapping[str, Image]) -> tuple[str, ...]:
    """A note that names the difference tiles whose no change is not mid-grey: their colours were altered."""
    altered = [n for n, image in images.items() if abs(float(np.median(image)) - _MID_GREY) > _GREY_TOLERANCE]
    if not altered:
        return ()
    listed = ", ".join(altered[:_MAX_NAMES]) + (", ..." if len(altered) > _MAX_NAMES else "")
    return (f"colours of {len(altered)} of {len(images)} tiles are jittered (no change is not mid-grey): {listed}",)


def check_pairing(pairs: Sequence[ImprintPair]) -> tuple[StageWarning, ...]:
    """Return warnings where the pairs do not seem to be of one touch each."""
    order = compare_signatures(
        [compute_signature(pair.contact) for pair in pairs], [compute_signature(pair.imprint) for pair in pairs]
    )
    return () if order is None or order.warning is None else (order.warning,)


def _match_names(folder: Path, pattern: str) -> dict[str, Path]:
    if pattern.count("*") != 1:
        raise FileProblem(f"a pattern of names has one '*', got {pattern!r}", folder)
    before, after = pattern.split("*")
    files = [p for p in folder.iterdir() if image_files.is_image_file(p) and len(p.name) >= len(before) + len(after)]
    return {p.name[len(before) : len(p.name) - len(after)]: p
            for p in files if p.name.startswith(before) and p.name.endswith(after)}  # fmt: skip


def _tiles(name: str, source: Ridges, target: Path) -> ImprintPair:
    grey = image_files.read_rgb(target).astype(np.float32).mean(axis=2)
    return ImprintPair(name=name, contact=source.contact, source_size=_TILE, target_size=_TILE,
                imprint=freeze(np.ascontiguousarray(orient_image(grey, source.orientation))))  # fmt: skip
