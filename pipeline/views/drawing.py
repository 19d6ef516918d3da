"""What is drawn over the pixels of a preview, in the window and in files alike: outlines and a
scale bar, as values.
"""

import math
from collections.abc import Callable

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image
from pipeline.core.frozen import frozen
from pipeline.views.colours import Rgb
from pipeline.views.preview import Preview

CONTACT_COLOUR: Rgb = (230, 85, 13)  # outline of the contact mask
# outline of a contact to compare with, over a dark casing
OBSERVED_CONTACT_COLOUR: Rgb = (255, 255, 255)
CASING_COLOUR: Rgb = (20, 24, 30)
# the scale bar on dark pixels and on light ones
_LIGHT = (255, 255, 255)
_DARK = (30, 32, 36)
_BAR_LENGTHS_MM = (50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
# shares of what is visible: length, and distance from its corner
_LONGEST_BAR = 0.3
_BAR_RIGHT = 0.05
_BAR_UP = 0.04
_DARK_GREY = 130.0


@frozen
class Line:
    """A line over an image, whose first pixel begins at (0, 0)."""

    points_px: Floats | Doubles  # (n, 2) x, y; NaN between pieces
    rgb: Rgb
    width: float  # of the pen, in pixels of a screen at 96 dpi
    opacity: float = 1.0


@frozen
class ScaleBar:
    """A bar of a round length at the lower right; its text is centred above it."""

    line: Line
    text: str


def list_outlines(preview: Preview) -> tuple[Line, ...]:
    """The contact's outlines, the lowest first: the observed one and its casing, then the
    preview's own.
    """
    observed = preview.observed_outline_px
    own = preview.outline_px
    pens = (
        (observed, CASING_COLOUR, 3.4, 0.75),
        (observed, OBSERVED_CONTACT_COLOUR, 1.6, 1.0),
        (own, CONTACT_COLOUR, 1.6, 1.0),
    )
    return tuple(
        Line(points_px=outline, rgb=rgb, width=width, opacity=opacity)
        for outline, rgb, width, opacity in pens
        if outline is not None and len(outline)
    )


def choose_bar_length_mm(longest_mm: float) -> float:
    """Return the longest round length of a scale bar; 0 where all are too long."""
    return next((length for length in _BAR_LENGTHS_MM if length <= longest_mm), 0.0)


def make_scale_bar(
    preview: Preview,
    visible_px: tuple[float, float, float, float],
    recolour: Callable[[Image], Image] = np.asarray,
) -> ScaleBar | None:
    """The scale bar of the visible part (left, top, right, bottom) of an image.

    None where its scale is not known.

    The bar is light on dark pixels, as `recolour` shows them.
    """
    left, top, right, bottom = visible_px
    longest_mm = _LONGEST_BAR * (right - left) * preview.pixel_mm
    length_mm = choose_bar_length_mm(longest_mm)
    if not (length_mm and math.isfinite(longest_mm)):
        return None
    rows, cols = preview.pixels.shape[:2]
    corner = recolour(preview.pixels[-(rows // 6) :: 3, -(cols // 3) :: 3])
    rgb = _LIGHT if corner.mean() < _DARK_GREY else _DARK
    end = right - _BAR_RIGHT * (right - left)
    y = bottom - _BAR_UP * (bottom - top)
    points = np.array([(end - length_mm / preview.pixel_mm, y), (end, y)])
    return ScaleBar(line=Line(points_px=points, rgb=rgb, width=3.0), text=f"{length_mm:g} mm")
