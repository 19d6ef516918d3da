"""Colour bar with limits and unit, a histogram of the values, and the share beyond the limits."""

import math
from typing import Any, NamedTuple

import numpy as np
from PyQt6.QtCore import QPointF, QRectF, Qt, pyqtSignal
from PyQt6.QtGui import QPainter

from pipeline.core.arrays import Doubles, Floats
from pipeline.views.colours import ColourScale, get_colour_table
from widgets.style.base import FIXED, YIELDS, PaintedWidget
from widgets.style.styling import make_single_shot_timer
from widgets.style.theme import ThemeColours, get_colour_map, to_qcolor
from widgets.views.preview_renderer import make_qimage

_STRIP_PX = 8
_BARS_PX = 22
_EDGE_PX = 2
_N_BARS = 64
_EVERY = 2  # stride of the pixels that are counted: the same histogram for a quarter of the time
_NEAR_PX = 12.0  # distance to an end of the bar within which it can be dragged
_THROTTLE_MS = 33
_BELOW = "\N{BLACK LEFT-POINTING SMALL TRIANGLE} {}"
_ABOVE = "{} \N{BLACK RIGHT-POINTING SMALL TRIANGLE}"
_OUTSIDE = 1.0  # per cent of the values that fitted limits leave out on either side
_MIN_SHARE = 0.001  # a smaller share beyond a limit gets no mark
_NOISE = 0.01  # share of the range: values this little below the lowest colour are noise


class ValueHistogram(NamedTuple):
    """Distribution of values on a colour scale."""

    counts: Doubles  # (n,) values in equal bins from the lowest to the highest colour
    share_below: float  # share of finite values below the lowest colour
    share_above: float  # share above the highest colour


def compute_histogram(values: Floats, scale: ColourScale) -> ValueHistogram:
    """Return the histogram of `values` on `scale`; NaN is not counted."""
    seen = values[::_EVERY, ::_EVERY] if values.ndim == 2 else values
    known = seen[np.isfinite(seen)]
    counts, _ = np.histogram(known, bins=_N_BARS, range=(scale.low, scale.high))
    noise = _NOISE * (scale.high - scale.low)
    beyond = np.stack([known < scale.low - noise, known > scale.high])
    return ValueHistogram(counts.astype(np.float64), *(beyond.sum(axis=1) / max(1, known.size)))


def fit_limits(values: Floats, scale: ColourScale) -> dict[str, float]:
    """Return setting -> value of limits that leave out one per cent of the values at either end.

    Empty where no setting controls a limit, or where all values are equal.
    """
    known = values[np.isfinite(values)]
    if not known.size:
        return {}
    low, high = (float(v) for v in np.percentile(known, (_OUTSIDE, 100 - _OUTSIDE)))
    if scale.low_setting == scale.high_setting:
        low, high = 0.0, max(abs(low), abs(high))
    limits = {scale.low_setting: low, scale.high_setting: high}
    return {name: value for name, value in limits.items() if name} if high > low else {}


class ColourBar(PaintedWidget):
    """Histogram over a colour strip over its numbers; empty for images in true colour.

    An end with a setting can be dragged: `limit_dragged` carries setting and value, at most thirty
    times a second. A double click fits the limits: `limits_fitted` carries setting -> value.
    """

    limit_dragged = pyqtSignal(str, float)
    limits_fitted = pyqtSignal(object)

    def __init__(self) -> None:
        super().__init__("levels", across=YIELDS, down=FIXED)
        # room for the bars, the strip and one line of numbers
        self.preferred_px = 120, _BARS_PX + _STRIP_PX + self.fontMetrics().height() + 3
        self._scale: ColourScale | None = None
        self._values: Floats | None = None
        self._spread: ValueHistogram | None = None
        # setting, scale and side of the drag
        self._held: tuple[str, ColourScale, float] | None = None
        self._wanted = math.nan
        self._soon = make_single_shot_timer(self, _THROTTLE_MS, self._tell)
        self.setMouseTracking(True)

    def show_scale(self, scale: ColourScale | None, values: Floats | None = None) -> None:
        """Show the colours and limits of `scale` and the histogram of `values`.

        None clears the bar.
        """
        if scale == self._scale and values is self._values:
            return
        self._scale = scale
        self._values = values
        self._spread = None
        self.update()

    @property
    def histogram(self) -> ValueHistogram | None:
        """The histogram of the values; computed when it is painted."""
        if self._spread is None and self._scale is not None and self._values is not None:
            self._spread = compute_histogram(self._values, self._scale)
            self.setToolTip(_describe(self._scale, self._spread))
        return self._spread

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint bars, strip and numbers."""
        if self._scale is None:
            return
        scale = self._scale
        palette = self.palette()
        strip = self._room
        if self.histogram is not None:
            self._draw_bars(painter, ink, strip, self.histogram)
        colours = get_colour_table(get_colour_map(ink, scale))
        painter.drawImage(strip, make_qimage(colours[None]))
        painter.setPen(palette.mid().color())
        painter.drawRect(strip)
        painter.setPen(palette.text().color())
        row = QRectF(2, strip.bottom() + 1, self.width() - 4, self.fontMetrics().height() + 2)
        low, high = f"{scale.low:g}", f"{scale.high:g} {scale.unit}"
        middle = f"{0.5 * (scale.low + scale.high):g}"
        painter.drawText(row, Qt.AlignmentFlag.AlignLeft, low)
        painter.drawText(row, Qt.AlignmentFlag.AlignRight, high)
        wide = self.fontMetrics().horizontalAdvance
        # only where there is room
        if 0.5 * wide(middle) + max(wide(low), wide(high)) + _EDGE_PX < 0.5 * row.width():
            painter.drawText(row, Qt.AlignmentFlag.AlignHCenter, middle)

    @property
    def _room(self) -> QRectF:
        return QRectF(_EDGE_PX, _BARS_PX, self.width() - 2 * _EDGE_PX, _STRIP_PX)

    def _draw_bars(
        self, painter: QPainter, ink: ThemeColours, strip: QRectF, spread: ValueHistogram
    ) -> None:
        """Paint bars with logarithmic heights: the contact is a small part of an image."""
        tall = np.log1p(spread.counts)
        tall *= (_BARS_PX - 2) / max(1e-9, float(tall.max(initial=0.0)))
        wide = strip.width() / _N_BARS
        for i, high in enumerate(tall):
            left = strip.left() + i * wide
            bar = QRectF(left, strip.top() - high, max(1.0, wide - 0.5), high)
            painter.fillRect(bar, to_qcolor(ink.secondary_text, 150))
        painter.setPen(to_qcolor(ink.warning_mark))
        line = QRectF(strip.left() + 4, 0, strip.width() - 8, self.fontMetrics().height())
        for share, x, text, place in (
            (spread.share_below, strip.left(), _BELOW, Qt.AlignmentFlag.AlignLeft),
            (spread.share_above, strip.right() - 3, _ABOVE, Qt.AlignmentFlag.AlignRight),
        ):
            if share >= _MIN_SHARE:
                painter.fillRect(QRectF(x, 0, 3, strip.top()), to_qcolor(ink.warning_mark))
                label = text.format(f"{100 * share:.{0 if share >= 0.01 else 1}f} %")
                words = painter.boundingRect(line, place, label)
                painter.fillRect(words.adjusted(-1, 0, 1, 0), self.palette().window())
                painter.drawText(line, place, label)

    def mousePressEvent(self, a0: Any) -> None:  # noqa: N802
        """Begin to drag an end."""
        self._held = self._end_at(a0.position())

    def mouseMoveEvent(self, a0: Any) -> None:  # noqa: N802
        """Drag an end on the scale of the press; without a button show where one can be dragged."""
        if self._held is None:
            near = self._end_at(a0.position()) is not None
            self.setCursor(Qt.CursorShape.SizeHorCursor if near else Qt.CursorShape.ArrowCursor)
            return
        _, scale, side = self._held
        room = self._room
        share = (a0.position().x() - room.left()) / room.width()
        value = scale.low + share * (scale.high - scale.low)
        mirrored = scale.low_setting == scale.high_setting
        self._wanted = max(side * value, 0.0) if mirrored else value
        if not self._soon.isActive():
            self._soon.start()

    def mouseReleaseEvent(self, a0: Any) -> None:  # noqa: N802
        """Emit the final limit."""
        del a0
        if self._soon.isActive():
            self._soon.stop()
            self._tell()
        self._held = None

    def mouseDoubleClickEvent(self, a0: Any) -> None:  # noqa: N802
        """Fit the limits to nearly all values."""
        del a0
        self._held = None
        if self._scale is None or self._values is None:
            return
        fitted = fit_limits(self._values, self._scale)
        if fitted:
            self.limits_fitted.emit(fitted)

    def _tell(self) -> None:
        if self._held is not None and math.isfinite(self._wanted):
            self.limit_dragged.emit(self._held[0], self._wanted)

    def _end_at(self, at: QPointF) -> tuple[str, ColourScale, float] | None:
        scale = self._scale
        room = self._room
        if scale is None:
            return None
        for setting, x, side in (
            (scale.low_setting, room.left(), -1.0),
            (scale.high_setting, room.right(), 1.0),
        ):
            if setting and abs(at.x() - x) <= _NEAR_PX:
                return setting, scale, side
        return None


def _describe(scale: ColourScale, spread: ValueHistogram) -> str:
    lines = [f"{scale.quantity}, {scale.low:g} to {scale.high:g} {scale.unit}"]
    for share, where in (
        (spread.share_below, f"below {scale.low:g}"),
        (spread.share_above, f"above {scale.high:g}"),
    ):
        if share >= _MIN_SHARE:
            lines.append(
                f"{100 * share:.1f} % of the values lie {where} {scale.unit}, in the colour of "
                "that end"
            )
    can = "drag an end to set the limit; double-click to fit both to 98 % of the values"
    lines.append(can if scale.high_setting else "these limits follow another scale")
    return "\n".join(lines)
