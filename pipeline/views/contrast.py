"""One scale for two images that show the same quantity."""

from dataclasses import replace

from pipeline.views.colours import apply_colour_map
from pipeline.views.preview import Preview


def share_scale(first: Preview, second: Preview) -> tuple[Preview, Preview]:
    """Return two images with limits that hold both, where they show one quantity on scales of
    other limits.
    """
    a = first.scale
    b = second.scale
    if (
        a is None
        or b is None
        or a == b
        or (a.quantity, a.unit, a.colour_map) != (b.quantity, b.unit, b.colour_map)
    ):
        return first, second
    low = min(a.low, b.low)
    high = max(a.high, b.high)
    return _set_limits(first, low, high), _set_limits(second, low, high)


def _set_limits(preview: Preview, low: float, high: float) -> Preview:
    if preview.scale is None or preview.values is None:
        return preview
    scale = replace(preview.scale, low=low, high=high)
    return replace(preview, scale=scale, pixels=apply_colour_map(preview.values, scale))
