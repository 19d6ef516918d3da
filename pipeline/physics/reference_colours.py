"""Comparison of a reference image's colours with those of its sensor's description, as it is and
after corrections.
"""

import contextlib
from collections.abc import Iterator
from typing import Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Image
from pipeline.core.derived import derive_once
from pipeline.core.errors import TouchError
from pipeline.core.frozen import frozen
from pipeline.physics.optics import render_reference
from pipeline.sensors.spec import SensorSpec, list_sensor_names, load_sensor

_BLOCK_PX = 8  # grid of the comparison, coarser than noise and markers
_MARGIN = 0.2  # by which a corrected image must be more similar for a warning
# least similarity of the corrected image; real instances reach 0.87 to 0.99 (`inspect` on
# recordings)
_FITS = 0.6
# possible mirroring: remaining dissimilarity, and least similarity
_MIRROR_SHARE = 0.5
_MIRROR_FITS = 0.8
# largest similarity of a sensor that nobody described; clips of a GelSlim 4.0 reach 0.20 to 0.54
_FOREIGN = 0.15
# by which another sensor must be more similar than this one swapped, mirrored or rotated
_OWN_MARGIN = 0.05
# mean difference of a pixel's colours from their mean; lit gels have 10 and more
_COLOURLESS_GREY = 1.0


_Number = TypeVar("_Number", bound=np.generic)
MirrorDirection = Literal["left to right", "top to bottom"]


@frozen
class ColourComparison:
    """Similarity of a reference image to its sensor's nominal one."""

    similarity: float  # -1..1, 1 = the same
    problem: str = ""  # what is wrong, as a clause; "" = nothing detected
    corrected_similarity: float = float("nan")  # after correction of the problem
    # a little more similar mirrored; a touch may confirm it
    possible_mirroring: MirrorDirection | None = None


def compare_colours(image: Image, spec: SensorSpec) -> ColourComparison:
    """Compare a reference image (rows, cols, 3) with the sensor's nominal one of the same size.

    Detects swapped channels, mirrored or rotated images, those of another sensor, of a light that
    nobody described, and those without colours. Raises SettingProblem for a sensor without optics
    in its description.
    """
    return _compare(image, render_reference(spec), spec.name)


@derive_once
def _compare(seen: Image, want: Image, name: str) -> ColourComparison:
    coarse = _average_blocks(seen)
    plain = _compute_similarity(coarse, _average_blocks(want))
    if float(np.abs(coarse).mean()) < _COLOURLESS_GREY:
        return ColourComparison(similarity=plain, problem="it has no colours")
    if plain + _MARGIN < 1.0:
        odd, best = _pick_best(_list_corrections(seen, want))
        other, more = _pick_best(_list_other_sensors(seen, name))
        if more > best + _OWN_MARGIN:
            odd = other
            best = more
        if best > max(_FITS, plain + _MARGIN):
            return ColourComparison(similarity=plain, problem=odd, corrected_similarity=best)
        if plain < _FOREIGN:
            nearest = (
                f"; {other.removeprefix('it ')} at best"
                if more > max(_FOREIGN, best - _OWN_MARGIN)
                else ""
            )
            return ColourComparison(
                similarity=plain, problem=f"its colours are those of another light{nearest}"
            )
    how, best = max(
        (
            (
                how,
                _compute_similarity(
                    _average_blocks(mirror_image(seen, how)), _average_blocks(want)
                ),
            )
            for how in get_args(MirrorDirection)
        ),
        key=lambda result: result[1],
    )
    return ColourComparison(
        similarity=plain,
        possible_mirroring=how
        if best > max(_MIRROR_FITS, 1.0 - _MIRROR_SHARE * (1.0 - plain))
        else None,
    )


def mirror_image(picture: NDArray[_Number], how: MirrorDirection) -> NDArray[_Number]:
    """The image (rows, cols, ...) with its columns or its rows reversed."""
    return np.ascontiguousarray(picture[:, ::-1] if how == "left to right" else picture[::-1])


def _pick_best(ways: Iterator[tuple[str, Image, Image]]) -> tuple[str, float]:
    """The problem whose correction is the most similar, and that similarity."""
    found = (
        (how, _compute_similarity(_average_blocks(a), _average_blocks(b))) for how, a, b in ways
    )
    return max(found, key=lambda way: way[1], default=("", -1.0))


def _list_corrections(seen: Image, want: Image) -> Iterator[tuple[str, Image, Image]]:
    """(problem, corrected image, nominal image) of the same sensor."""
    yield "red and blue look swapped (in Python give image[..., ::-1])", seen[:, :, ::-1], want
    yield "it looks mirrored", mirror_image(seen, "left to right"), want
    yield "it looks mirrored top to bottom", mirror_image(seen, "top to bottom"), want
    yield "it looks rotated by 180 degrees", seen[::-1, ::-1], want


def _list_other_sensors(seen: Image, name: str) -> Iterator[tuple[str, Image, Image]]:
    """(problem, corrected image, nominal image) of every other sensor, rotated by quarter turns."""
    import cv2

    for other in list_sensor_names():
        spec = None
        with contextlib.suppress(TouchError):  # the description of another package may be damaged
            spec = load_sensor(other)
        if other == name or spec is None or spec.optics is None:
            continue
        picture = render_reference(spec)
        for quarters, how in enumerate(
            ("", " rotated by 90 degrees", " rotated by 180 degrees", " rotated by 90 degrees")
        ):
            turned = np.ascontiguousarray(np.rot90(seen, quarters))
            if (turned.shape[0] < turned.shape[1]) == (picture.shape[0] < picture.shape[1]):
                sized = cv2.resize(
                    turned, (picture.shape[1], picture.shape[0]), interpolation=cv2.INTER_AREA
                )
                yield f"it looks like one of {other}{how}", np.asarray(sized, np.uint8), picture


def _average_blocks(picture: NDArray[np.number]) -> Doubles:
    """Colours of blocks (rows, cols, 3), less their mean: brightness, vignette and markers."""
    rows, cols = (n // _BLOCK_PX * _BLOCK_PX for n in picture.shape[:2])
    blocks = picture[:rows, :cols].reshape(
        rows // _BLOCK_PX, _BLOCK_PX, cols // _BLOCK_PX, _BLOCK_PX, 3
    )
    coarse = blocks.mean(axis=(1, 3), dtype=np.float64)
    return np.asarray(coarse - coarse.mean(axis=2, keepdims=True), np.float64)


def _compute_similarity(seen: Doubles, want: Doubles) -> float:
    """Cosine (-1..1) between two colour patterns less their means, so that white balance does
    not count.
    """
    a = seen - seen.mean(axis=(0, 1))
    b = want - want.mean(axis=(0, 1))
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float((a * b).sum() / size) if size > 0 else 0.0
