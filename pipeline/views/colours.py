"""Colours of quantities: the same in previews, 3D, sheets and colour bars.

Depth is viridis, signed differences use a diverging map with a neutral centre, categories are
Okabe-Ito. No rainbow.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.frozen import frozen

ColourMapName = Literal["viridis", "diverging", "diverging_dark"]
Rgb = tuple[int, int, int]

NO_VALUE_COLOUR: Rgb = (224, 226, 230)  # NaN: a grey that no map contains
REGISTERED_POINT_COLOUR: Rgb = (213, 94, 0)  # registered points, Okabe-Ito vermilion
UNMATCHED_POINT_COLOUR: Rgb = (128, 130, 136)  # such a point beyond the distance limit
OBJECT_COLOUR: Rgb = (86, 140, 190)
SOURCE_COLOUR: Rgb = (230, 159, 0)  # the source's camera in a scene, Okabe-Ito orange
TARGET_COLOUR: Rgb = (86, 180, 233)  # the target's, sky blue
RECORDED_COLOUR: Rgb = (205, 210, 220)  # the membrane that the target itself recorded
MEMBRANE_COLOUR: Rgb = (150, 160, 175)

# Every 16th colour of the perceptually uniform map D1 (Kovesi, "Good colour maps",
# arXiv:1509.03700).
_DIVERGING = (
    "2151db",
    "5262de",
    "7075e2",
    "8a88e5",
    "a09ce8",
    "b6b1ea",
    "cac5ed",
    "dddbef",
    "eee7e9",
    "f2d7d0",
    "f0beb2",
    "eda594",
    "e78c77",
    "e0735b",
    "d7583f",
    "cc3924",
    "c00206",
)
# The same around a dark centre, for dark windows: lightness falls in equal steps from 77 to 12 and
# rises again.
_DIVERGING_DARK = (
    "96beff",
    "689cfa",
    "4476e2",
    "3054ac",
    "24386c",
    "1e1f24",
    "5c2234",
    "92304c",
    "c44868",
    "ec748e",
    "ffacba",
)


@frozen
class ColourScale:
    """Maps values to colours, between absolute limits."""

    colour_map: ColourMapName
    low: float
    high: float
    unit: str
    quantity: str  # what is shown and its sign, such as "indentation, + toward camera"
    low_setting: str = ""  # display setting of the lower limit, "" = none
    # display setting of the upper limit; the same name for both means symmetric limits
    high_setting: str = ""
    is_subtractable: bool = True  # whether the difference of two such values has a meaning


def get_colour_table(name: ColourMapName) -> Image:
    """Return the 256 colours (256, 3) uint8 of a map, from low to high."""
    import cv2

    levels = np.arange(256, dtype=np.uint8)
    if name == "viridis":
        drawn = np.asarray(cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS), np.uint8)
        return freeze(np.ascontiguousarray(drawn[:, 0, ::-1]))
    colours = _DIVERGING if name == "diverging" else _DIVERGING_DARK
    at = np.linspace(0.0, 255.0, len(colours))
    anchors = np.frombuffer(bytes.fromhex("".join(colours)), np.uint8).reshape(-1, 3)
    mixed = np.stack([np.interp(levels, at, anchors[:, k]) for k in range(3)], axis=-1)
    return freeze(np.rint(mixed).astype(np.uint8))


def apply_colour_map(values: Floats, scale: ColourScale) -> Image:
    """Return the colours (..., 3) uint8 of values (...), clipped to the limits.

    NaN becomes `NO_VALUE_COLOUR`.
    """
    known = np.isfinite(values)
    share = (np.where(known, values, scale.low) - scale.low) * (255.0 / (scale.high - scale.low))
    out = get_colour_table(scale.colour_map)[np.clip(share, 0.0, 255.0).astype(np.uint8)]
    out[~known] = NO_VALUE_COLOUR
    return freeze(out)


def darken_diverging(pixels: Image) -> Image:
    """Return colours (..., 3) of the diverging map as those of the dark one; other colours stay."""
    at = locate_in_colour_table(pixels, "diverging")
    return freeze(np.where((at >= 0)[..., None], get_colour_table("diverging_dark")[at], pixels))


def locate_in_colour_table(pixels: Image, name: ColourMapName) -> NDArray[np.int16]:
    """Return the places (...) of colours (..., 3) in a map from 0 to 255; -1 = not of the map."""
    table = get_colour_table(name)
    index = np.full(1 << 16, -1, np.int16)
    index[_number_colours(table)] = np.arange(len(table), dtype=np.int16)
    at = index[_number_colours(pixels)]
    return freeze(np.where((pixels == table[at]).all(axis=-1), at, np.int16(-1)))


def _number_colours(pixels: Image) -> NDArray[np.uint16]:
    """Return a number (...) that differs for all colours (..., 3) of a map."""
    red, green, blue = (pixels[..., k].astype(np.uint16) for k in range(3))
    return 1280 * red + 5 * green + 257 * blue


def repeat_colour(colour: Rgb, count: int) -> NDArray[np.uint8]:
    """Return the same colour for `count` points, (count, 3)."""
    return freeze(np.broadcast_to(np.array(colour, dtype=np.uint8), (count, 3)).copy())
