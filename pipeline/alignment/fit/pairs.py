"""Load imprint pairs to fit an alignment to: tiles of a training set, or moments recorded by both sensors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.alignment.fit.difference_tiles import Ridges, detect_ridges
from pipeline.alignment.fit.image_rotation import describe_orientation, orient_image
from pipeline.alignment.fit.transfer import ImprintPair
from pipeline.alignment.touches import AlignmentTouch
from pipeline.base.arrays import Floats, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.stage_warnings import StageWarning
from pipeline.inspection.synchrony import compare_signatures, compute_signature
from pipeline.recordings import image_files
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import DepthMap

_COMMON_SHARE = 0.8  # share of tiles with one orientation above which it is used for all
_TILE = (1.0, 1.0)  # width and height: the unit of tiles is the tile


@dataclass(frozen=True, slots=True, kw_only=True)
class ImprintPairs:
    """Imprint pairs, and notes about them."""

    pairs: tuple[ImprintPair, ...]
    notes: tuple[str, ...]


def load_tile_pairs(folder: Path, source: SensorSpec, source_names: str, target_names: str) -> ImprintPairs:
    """Load images of `folder` whose names match both patterns (one `*` each, equal in a pair).

    A source's tile is a difference image, a target's a grey imprint. Rotated tiles are oriented by their own colours;
    the target's tile is rotated with its source's. Raises FileProblem where nothing is paired.
    """
    found = _match_names(folder, source_names), _match_names(folder, target_names)
    names = sorted(found[0].keys() & found[1].keys(), key=lambda n: image_files.natural_sort_key(Path(n)))
    if not names:
        raise FileProblem(f"no two images are named {source_names} and {target_names}", folder)
    read = {name: detect_ridges(image_files.read_rgb(found[0][name]), source) for name in names}
    way, count = Counter(r.orientation for r in read.values()).most_common(1)[0]
    alike = count >= _COMMON_SHARE * len(names)
    if alike:
        read = {
            n: r if r.orientation == way else detect_ridges(image_files.read_rgb(found[0][n]), source, way)
            for n, r in read.items()
        }
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
    return ImprintPairs(pairs=pairs, notes=(note, clarity, *_check_pairing(pairs)))


def make_touch_pairs(touches: Sequence[AlignmentTouch]) -> ImprintPairs:
    """Make pairs of the moments with contact on both sensors, in millimetres on either rest surface."""
    made = tuple(_touch(t) for t in touches if t.has_contact_on_both)
    return ImprintPairs(
        pairs=made, notes=(f"{len(made)} of {len(touches)} moments have contact on both sensors", *_check_pairing(made))
    )


def compute_pixel_mm(depth: DepthMap) -> float:
    """Return the width of a pixel at the median depth."""
    seen = depth.depth_mm[np.isfinite(depth.depth_mm)]
    return float(np.median(seen)) / depth.camera.fx_px


def _check_pairing(pairs: Sequence[ImprintPair]) -> tuple[StageWarning, ...]:
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


def _touch(touch: AlignmentTouch) -> ImprintPair:
    def size(depth: DepthMap) -> tuple[float, float]:
        return depth.camera.cols * compute_pixel_mm(depth), depth.camera.rows * compute_pixel_mm(depth)

    imprint: Floats = np.nan_to_num(touch.target.indentation_mm).astype(np.float32)
    return ImprintPair(name=str(touch.index), contact=freeze(touch.source.contact.astype(np.float32)), is_metric=True,
                source_size=size(touch.source), imprint=freeze(imprint), target_size=size(touch.target))  # fmt: skip
