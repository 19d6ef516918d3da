"""Whether an untouched picture's colours lie as its sensor's description has them, or more so once it is changed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Image
from pipeline.base.memo import Memo
from pipeline.engine.digests import compute_cached_digest
from pipeline.physics.optics import render_reference
from pipeline.sensors.spec import SensorSpec, list_sensor_names, load_sensor

_BLOCK_PX = 8  # colours are compared on a coarse grid, below the grain of noise and markers
_MARGIN = 0.2  # how much better a changed picture must fit before the recording is doubted
_FITS = 0.6  # ... and how well: units of one make reach 0.87 to 0.99 (`inspect` on real recordings)
_CLOSER, _ALMOST = 0.5, 0.8  # of what is unlike, left by a mirrored picture that may be meant, and how alike it is
_OWN_MARGIN = 0.05  # by which another sensor's picture must fit better than this one's, swapped, mirrored or turned
_COLOURLESS_GREY = 1.0  # mean difference of a pixel's colours from their mean; lit gels have 10 and more


_Number = TypeVar("_Number", bound=np.generic)
MirrorDirection = Literal["left to right", "top to bottom"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourComparison:
    """How an untouched picture compares with its sensor's."""

    similarity: float  # -1..1, 1 = the same
    problem: str = ""  # what is wrong with it, as a clause; "" = nothing is known to be
    corrected_similarity: float = float("nan")  # the likeness once that is undone
    possible_mirroring: MirrorDirection | None = None  # it would be a little more alike so, which a touch may confirm


def compare_colours(seen: Image, spec: SensorSpec) -> ColourComparison:
    """How the untouched picture (rows, cols, 3) compares with the described one of the same size.

    Swapped channels, a mirrored or turned picture, another sensor's and one without colours are told. Raises
    SettingProblem for a sensor whose lights are not described.
    """
    return _compared.get_or_make(
        (compute_cached_digest(seen), compute_cached_digest(render_reference(spec))),
        lambda: _made(seen, render_reference(spec), spec.name),
    )


_compared: Memo[tuple[str, str], ColourComparison] = Memo(16)


def _made(seen: Image, want: Image, name: str) -> ColourComparison:
    coarse = _coarse(seen)
    plain = _likeness(coarse, _coarse(want))
    if float(np.abs(coarse).mean()) < _COLOURLESS_GREY:
        return ColourComparison(similarity=plain, problem="it has no colours")
    if plain + _MARGIN < 1.0:
        odd, best = _best(_own_ways(seen, want))
        other, more = _best(_other_sensors(seen, name))
        if more > best + _OWN_MARGIN:
            odd, best = other, more
        if best > max(_FITS, plain + _MARGIN):
            return ColourComparison(similarity=plain, problem=odd, corrected_similarity=best)
    how, best = max(((how, _likeness(_coarse(mirror_image(seen, how)), _coarse(want))) for how in get_args(MirrorDirection)),
                    key=lambda way: way[1])  # fmt: skip
    return ColourComparison(
        similarity=plain, possible_mirroring=how if best > max(_ALMOST, 1.0 - _CLOSER * (1.0 - plain)) else None
    )


def mirror_image(picture: NDArray[_Number], how: MirrorDirection) -> NDArray[_Number]:
    """The picture (rows, cols, ...) with its columns or its rows the other way round."""
    return np.ascontiguousarray(picture[:, ::-1] if how == "left to right" else picture[::-1])


def _best(ways: Iterator[tuple[str, Image, Image]]) -> tuple[str, float]:
    """What would be wrong with the picture that comes nearest to what it would then look like, and its likeness."""
    found = ((how, _likeness(_coarse(a), _coarse(b))) for how, a, b in ways)
    return max(found, key=lambda way: way[1], default=("", -1.0))


def _own_ways(seen: Image, want: Image) -> Iterator[tuple[str, Image, Image]]:
    """(what would be wrong, the picture with that undone, what it would then look like), of the same sensor."""
    yield "red and blue look swapped", seen[:, :, ::-1], want
    yield "it looks mirrored", mirror_image(seen, "left to right"), want
    yield "it looks mirrored top to bottom", mirror_image(seen, "top to bottom"), want
    yield "it looks turned by 180 degrees", seen[::-1, ::-1], want


def _other_sensors(seen: Image, name: str) -> Iterator[tuple[str, Image, Image]]:
    """The same of every other sensor's picture, turned by quarters."""
    import cv2

    for other in list_sensor_names():
        spec = load_sensor(other)
        if other == name or spec.optics is None:
            continue
        picture = render_reference(spec)
        for quarters, how in enumerate(("", " turned a quarter", " turned by 180 degrees", " turned a quarter")):
            turned = np.ascontiguousarray(np.rot90(seen, quarters))
            if (turned.shape[0] < turned.shape[1]) == (picture.shape[0] < picture.shape[1]):
                sized = cv2.resize(turned, (picture.shape[1], picture.shape[0]), interpolation=cv2.INTER_AREA)
                yield f"it looks like one of {other}{how}", np.asarray(sized, np.uint8), picture


def _coarse(picture: NDArray[np.number]) -> Doubles:
    """Colours of blocks (rows, cols, 3), less what all three share: brightness, vignette and markers."""
    rows, cols = (n // _BLOCK_PX * _BLOCK_PX for n in picture.shape[:2])
    blocks = picture[:rows, :cols].reshape(rows // _BLOCK_PX, _BLOCK_PX, cols // _BLOCK_PX, _BLOCK_PX, 3)
    coarse = blocks.mean(axis=(1, 3), dtype=np.float64)
    return np.asarray(coarse - coarse.mean(axis=2, keepdims=True), np.float64)


def _likeness(seen: Doubles, want: Doubles) -> float:
    """Cosine (-1..1) between where colours lie; their means are taken out, so that no white balance counts."""
    a, b = seen - seen.mean(axis=(0, 1)), want - want.mean(axis=(0, 1))
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float((a * b).sum() / size) if size > 0 else 0.0
