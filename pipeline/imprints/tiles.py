"""Load imprint pairs from a folder of tiles, as training sets store them."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Image, freeze
from pipeline.base.errors import FileProblem, SettingProblem, StageWarning
from pipeline.imprints.image_rotation import ORIENTATIONS, describe_orientation, orient_image, rotate_half_turn
from pipeline.imprints.transfer import ImprintPair
from pipeline.inspection.synchrony import compare_signatures, compute_signature
from pipeline.recordings import file_names, image_files
from pipeline.sensors.spec import SensorSpec

_COMMON_SHARE = 0.8  # share of tiles with one orientation above which it is used for all
_TILE = (1.0, 1.0)  # width and height: the unit of tiles is the tile
SOURCE_TILES, TARGET_TILES = "*_gelslim.png", "*_bubble_gt.png"  # names of touch2touch's tiles
_MID_GREY, _GREY_TOLERANCE = 127.5, 45.0  # grey level of no change; published tiles: 112 to 165, altered ones 0 to 85
_MAX_NAMES = 5  # in a note
_SMOOTHED_PX = 1.5
_RIDGE_PX = 2.5  # half the width of a ridge's top in a tile of 128 px
_BORDER_PX = 6  # differences at a tile's edge are the camera's
_FULL_QUANTILE = 99.5  # quantile of the ridges that counts as full contact
_FULL_SHARE = 0.6  # share of that from which contact is full


@dataclass(frozen=True, slots=True, kw_only=True)
class Ridges:
    """Contact of a gel as far as a tile shows it: contrast-stretched, squeezed to a square, rotated.

    What is left of the touch is where its ridges are. The described LEDs map colour to slope, up to one factor; the
    slopes of a surface have no curl, and an indentation is sharper at its top than at its foot. So a tile alone
    determines its orientation.
    """

    contact: Floats  # (rows, cols) 0..1
    orientation: int  # `orient_image(tile, orientation)` is as the sensor's camera sees it
    curl_free: float  # share of the slopes' energy that a surface explains
    next_best: float  # the same of the best orientation other than this or half a turn from it


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
    names = sorted(found[0].keys() & found[1].keys(), key=lambda name: file_names.natural_sort_key(Path(name).stem))
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


def compute_colour_to_slope(spec: SensorSpec) -> Doubles:
    """Return (2, 3): change of colour to slope (right, down), up to one factor, from the described LEDs."""
    if spec.optics is None:
        raise SettingProblem(f"{spec.name} has no LEDs to estimate slopes from; it measures depth itself")
    colours = np.zeros((3, 2))
    for led in spec.optics.leds:
        angle = math.radians(led.azimuth_deg)
        colours -= np.outer(led.rgb, (math.cos(angle), math.sin(angle)))
    inverse = np.linalg.pinv(colours)
    return inverse / np.abs(inverse).max()


def detect_ridges(tile: Image, spec: SensorSpec, orientation: int | None = None) -> Ridges:
    """Detect the ridges of a tile (rows, cols, 3) in the camera's orientation; estimated if None."""
    matrix = compute_colour_to_slope(spec)
    explained = [_curl_free(*_slopes(orient_image(tile, k), matrix)) for k in ORIENTATIONS]
    best = int(np.argmax(explained)) if orientation is None else orientation
    if orientation is None and _skewness(_peaks(orient_image(tile, best), matrix)) < 0:
        best = rotate_half_turn(best)
    peaks = np.maximum(_peaks(orient_image(tile, best), matrix), 0.0)
    strongest = max(float(np.percentile(peaks, _FULL_QUANTILE)), 1e-9)
    others = [e for k, e in enumerate(explained) if k not in (best, rotate_half_turn(best))]
    contact = np.minimum(peaks / (strongest * _FULL_SHARE), 1.0).astype(np.float32)
    return Ridges(contact=freeze(contact), orientation=best,
                  curl_free=explained[best], next_best=max(others))  # fmt: skip


def _slopes(tile: NDArray[np.uint8], matrix: Doubles) -> tuple[Doubles, Doubles]:
    import cv2

    change = tile.astype(np.float64) - np.median(tile.reshape(-1, 3), axis=0)
    smooth = np.asarray(cv2.GaussianBlur(change, (0, 0), _SMOOTHED_PX)) @ matrix.T
    return smooth[..., 0], smooth[..., 1]


def _peaks(tile: NDArray[np.uint8], matrix: Doubles) -> Doubles:
    """Return the surface's curvature, highest on top of indentations; 0 at the tile's border."""
    import cv2

    gx, gy = (np.asarray(cv2.GaussianBlur(g, (0, 0), _RIDGE_PX - _SMOOTHED_PX + 1)) for g in _slopes(tile, matrix))
    bend = -(np.gradient(gx, axis=1) + np.gradient(gy, axis=0))
    inner = np.zeros_like(bend)
    inside = slice(_BORDER_PX, -_BORDER_PX)
    inner[inside, inside] = bend[inside, inside]
    return inner


def _skewness(values: Doubles) -> float:
    return float((values**3).mean() / max(float((values**2).mean()), 1e-12) ** 1.5)


def _curl_free(gx: Doubles, gy: Doubles) -> float:
    """Return the share of the slopes' energy that is the gradient of a surface, mirrored at the borders."""
    wide_x = np.block([[gx, -gx[:, ::-1]], [gx[::-1], -gx[::-1, ::-1]]])
    wide_y = np.block([[gy, gy[:, ::-1]], [-gy[::-1], -gy[::-1, ::-1]]])
    fx, fy = np.fft.fft2(wide_x), np.fft.fft2(wide_y)
    kx, ky = np.fft.fftfreq(wide_x.shape[1])[None, :], np.fft.fftfreq(wide_x.shape[0])[:, None]
    length_sq = kx**2 + ky**2
    length_sq[0, 0] = 1.0
    along = np.abs(kx * fx + ky * fy) ** 2 / length_sq
    return float(along.sum() / max(float((np.abs(fx) ** 2 + np.abs(fy) ** 2).sum()), 1e-12))
