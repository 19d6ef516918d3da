"""Place labels next to the points of a plot without overlap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

_AWAY_PX = 10.0
_TRIES = 40
_SIZE = 8.5
_Box = tuple[float, float, float, float]


def place_labels(axes: Any, canvas: Any, labels: Sequence[tuple[float, float, str, str]]) -> None:
    """Write (x, y, text, colour) labels to the right of their points, or as near as there is room.

    Where a label has to go farther off, a thin line leads to its point.
    """
    canvas.draw()  # the lay-out decides where the points are on the picture
    renderer = canvas.get_renderer()
    from matplotlib.patheffects import withStroke

    points = [axes.transData.transform((x, y)) for x, y, _, _ in labels]
    taken = [(x - 6, y - 6, x + 6, y + 6) for x, y in points]
    taken += [_corners(text.get_window_extent(renderer)) for text in axes.texts]
    inside = _corners(axes.get_window_extent(renderer))
    for (x, y, words, colour), (px, py) in zip(labels, points, strict=True):
        text = axes.annotate(words, (x, y), xytext=(0, 0), textcoords="offset pixels", color=colour, fontsize=_SIZE,
                             va="center", annotation_clip=False)  # fmt: skip
        box = text.get_window_extent(renderer)
        wide, tall = box.width, box.height
        dx, dy = _room(px, py, wide, tall, taken, inside)
        text.set(position=(dx, dy), path_effects=[withStroke(linewidth=2.5, foreground="white")])
        taken.append((px + dx, py + dy - tall / 2, px + dx + wide, py + dy + tall / 2))
        if abs(dy) > 2 * tall:
            axes.annotate("", (x, y), xytext=(dx + (0 if dx > 0 else wide), dy), textcoords="offset pixels",
                          arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.6, "alpha": 0.6})  # fmt: skip


def _room(x: float, y: float, wide: float, tall: float, taken: Sequence[_Box], inside: _Box) -> tuple[float, float]:
    """Offset of a label's left middle from its point, the nearest that is free and inside."""
    for k in range(_TRIES):
        dy = 0.6 * tall * ((k + 1) // 2) * (1 if k % 2 else -1)
        for dx in (_AWAY_PX, -_AWAY_PX - wide):
            box = (x + dx, y + dy - tall / 2, x + dx + wide, y + dy + tall / 2)
            within = box[0] >= inside[0] and box[2] <= inside[2] and box[1] >= inside[1] and box[3] <= inside[3]
            if within and not any(_meet(box, other) for other in taken):
                return dx, dy
    return _AWAY_PX, 0.0


def _corners(box: Any) -> _Box:
    return box.x0, box.y0, box.x1, box.y1


def _meet(a: _Box, b: _Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
