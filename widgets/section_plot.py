"""Plot of the heights of all stages along one line, over the same millimetres."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PyQt6 import sip
from PyQt6.QtCore import QLineF, QPointF, QRectF, Qt
from PyQt6.QtGui import QPainter, QPalette, QPen

from pipeline.previews.colours import Rgb
from pipeline.translation.cross_section import CrossSection, HeightProfile
from widgets.base import PaintedWidget, resize_font
from widgets.theme import CATEGORY_COLOURS, ThemeColours, get_theme_colours, to_qcolor

_LEFT_PX, _BELOW_PX, _ROOM_PX, _LEGEND_PX, _KEY_PX, _EDGE_PX = 60.0, 32.0, 8.0, 150.0, 26.0, 9.0
_STEPS = (1.0, 2.0, 5.0)
_SOLID, _DASH, _DOT, _DASH_DOT = "1", "1110", "10", "1111010"
_UNIT_PX = 4.0  # length of a dash pattern's unit
_HEIGHTS = ("indentation, mm", "depth, mm", "mm")  # axis labels; the first that fits
_LEAST_TICKS = 2  # one number is no scale


@dataclass(frozen=True, slots=True)
class CurveStyle:
    """How a curve is drawn: colour, dash pattern and width, since colours alone do not separate overlapping curves."""

    colour: Rgb | Literal["neutral", "accent", "text"]  # or one of the theme's
    pattern: str = _SOLID
    width_px: float = 1.8


_STROKES = {
    "source": CurveStyle("neutral"),
    "depth": CurveStyle("accent"),
    "cloud": CurveStyle(CATEGORY_COLOURS[1], _DOT, 2.6),
    "target_depth": CurveStyle(CATEGORY_COLOURS[2], _DASH),
    "touch": CurveStyle(CATEGORY_COLOURS[3], width_px=3.0),
    "touch_depth": CurveStyle(CATEGORY_COLOURS[5], _DASH_DOT),
    "true_source": CurveStyle("accent", _DOT),
    "true_target": CurveStyle("text", width_px=1.3),
}
_OTHER = CurveStyle("neutral", _DASH)


class SectionPlot(PaintedWidget):
    """Plots a `CrossSection`: mm along the line against mm of indentation, with gaps where nothing is known."""

    preferred_px = 640, 180

    def __init__(self) -> None:
        super().__init__("section_plot", "indentation along the section line")
        resize_font(self)
        self.section: CrossSection | None = None
        self.sensor_role = ""  # sensor whose curves are drawn, "" = both
        self.setMinimumSize(280, 110)
        self.setToolTip(
            "Indentation of every stage along the line, + toward the camera; marks at the bottom: start and "
            "end of its contact. Cloud points: perpendicular to the target's rest surface"
        )

    def show_section(self, section: CrossSection | None) -> None:
        """Draw this section."""
        self.section = section
        self.update()

    def show_sensor_role(self, place: str) -> None:
        """Draw the curves of the source or of the target alone; "" draws both."""
        self.sensor_role = place
        self.update()

    @property
    def visible_profiles(self) -> tuple[HeightProfile, ...]:
        """The curves that have a value anywhere."""
        profiles = () if self.section is None else self.section.profiles
        return tuple(p for p in profiles if self.sensor_role in ("", p.place) and np.isfinite(p.heights_mm).any())

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint axes, curves, contact edges and legend."""
        del ink
        known, section = self.visible_profiles, self.section
        if section is None or not known or not section.line.length_mm > 0:
            return
        room = QRectF(_LEFT_PX, _ROOM_PX, self.width() - _LEFT_PX - _LEGEND_PX - _ROOM_PX,
                      self.height() - _ROOM_PX - _BELOW_PX)  # fmt: skip
        low = min(0.0, *(float(np.nanmin(p.heights_mm)) for p in known))
        high = max(0.05, *(float(np.nanmax(p.heights_mm)) for p in known))
        span = 1.06 * (high - low)
        low = low - 0.03 * (high - low)
        self._draw_axes(painter, room, section.line.length_mm, (low, low + span))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)  # not for the grid: it would cost as much as a curve
        x = room.left() + room.width() * section.along_mm / section.line.length_mm
        for profile in sorted(
            known, key=lambda p: -_STROKES.get(p.name, _OTHER).width_px
        ):  # wide ones first, so that none is hidden
            painter.setPen(self._pen(profile.name))
            y = room.bottom() - room.height() * (profile.heights_mm - low) / span
            draw_lines(painter, compute_segments(x, y, _STROKES.get(profile.name, _OTHER).pattern))
            for edge in profile.contact_edges_mm:
                at = room.left() + room.width() * edge / section.line.length_mm
                painter.drawLine(QPointF(at, room.bottom() - _EDGE_PX), QPointF(at, room.bottom()))
        self._draw_legend(painter, known, room)

    def _pen(self, name: str) -> QPen:
        stroke = _STROKES.get(name, _OTHER)
        ink, text = get_theme_colours(self.palette()), self.palette().color(QPalette.ColorRole.WindowText)
        own = {"neutral": to_qcolor(ink.neutral), "accent": to_qcolor(ink.accent), "text": text}
        colour = own[stroke.colour] if isinstance(stroke.colour, str) else to_qcolor(stroke.colour)
        pen = QPen(colour, stroke.width_px)
        pen.setCapStyle(Qt.PenCapStyle.FlatCap)
        return pen

    def _draw_axes(self, painter: QPainter, room: QRectF, long_mm: float, span_mm: tuple[float, float]) -> None:
        palette, (low, high) = self.palette(), span_mm
        grid, words = palette.color(QPalette.ColorRole.Mid), palette.color(QPalette.ColorRole.WindowText)
        centre, right = Qt.AlignmentFlag.AlignCenter, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        for value in compute_ticks(0.0, long_mm, max(2, int(room.width() / 70))):
            x = room.left() + room.width() * value / long_mm
            painter.setPen(QPen(grid, 1, Qt.PenStyle.DotLine))
            painter.drawLine(QPointF(x, room.top()), QPointF(x, room.bottom()))
            painter.setPen(words)
            painter.drawText(QRectF(x - 30, room.bottom() + 1, 60, 14), centre, f"{value:.6g}")
        for value in compute_ticks(low, high, max(_LEAST_TICKS, int(room.height() / 20))):
            y = room.bottom() - room.height() * (value - low) / (high - low)
            painter.setPen(QPen(grid, 1, Qt.PenStyle.SolidLine if value == 0 else Qt.PenStyle.DotLine))
            painter.drawLine(QPointF(room.left(), y), QPointF(room.right(), y))
            painter.setPen(words)
            painter.drawText(QRectF(14, y - 8, _LEFT_PX - 19, 16), right, f"{value:.6g}")
        painter.setPen(grid)
        painter.drawRect(room)
        painter.setPen(words)
        painter.drawText(QRectF(room.left(), room.bottom() + 14, room.width(), 16), centre, "along the line A to B, mm")
        painter.save()
        painter.translate(2, room.bottom())
        painter.rotate(-90)
        letters = painter.fontMetrics()
        named = next((name for name in _HEIGHTS if letters.horizontalAdvance(name) <= room.height()), _HEIGHTS[-1])
        painter.drawText(QRectF(0, 0, room.height(), 14), centre, named)
        painter.restore()

    def _draw_legend(self, painter: QPainter, known: tuple[HeightProfile, ...], room: QRectF) -> None:
        left, tall = room.right() + _ROOM_PX, min(18.0, room.height() / len(known))
        for k, profile in enumerate(known):
            y = room.top() + (k + 0.5) * tall
            painter.setPen(self._pen(profile.name))
            key = np.linspace(left, left + _KEY_PX, 9)
            draw_lines(painter, compute_segments(key, np.full(9, y), _STROKES.get(profile.name, _OTHER).pattern))
            painter.setPen(self.palette().color(QPalette.ColorRole.WindowText))
            words = QRectF(left + _KEY_PX + 5, y - 9, self.width() - left - _KEY_PX - 6, 18)
            painter.drawText(words, Qt.AlignmentFlag.AlignVCenter, profile.title)


def compute_segments(
    x_px: NDArray[np.floating], y_px: NDArray[np.floating], pattern: str = "1"
) -> NDArray[np.floating]:
    """Return the line segments (n, 4) of a curve as x, y of start and end.

    Segments with a NaN and those at a 0 of the repeated dash pattern are left out. Qt paints segments in a tenth of the
    time of one polyline, dashed ones in a twentieth.
    """
    mean_px = float(np.ptp(x_px)) / max(1, len(x_px) - 1)
    unit = max(1, round(_UNIT_PX / mean_px)) if mean_px > 0 else 1
    on = np.array([mark == "1" for mark in pattern])[np.arange(len(x_px) - 1) // unit % len(pattern)]
    known = np.isfinite(y_px)
    kept = np.flatnonzero(on & known[1:] & known[:-1])
    return np.column_stack([x_px[kept], y_px[kept], x_px[kept + 1], y_px[kept + 1]])


def draw_lines(painter: QPainter, lines: NDArray[np.floating]) -> None:
    """Paint all segments with the painter's pen in one copy; one by one they cost more than painting."""
    if len(lines):
        made: Any = sip.array
        held = made(QLineF, len(lines))
        room: Any = sip.voidptr(held, lines.size * 8)
        np.frombuffer(room, np.float64)[:] = lines.ravel()
        painter.drawLines(held)


def compute_ticks(low: float, high: float, max_count: int) -> list[float]:
    """Return round numbers from `low` to `high` in steps of 1, 2 or 5 times a power of ten.

    At most `max_count`, but at least two.
    """
    found: list[float] = []
    while high > low and len(found) < _LEAST_TICKS:
        coarse = (high - low) / max_count
        power = 10.0 ** math.floor(math.log10(coarse))
        step = next((s * power for s in _STEPS if s * power >= coarse * (1 - 1e-9)), 10.0 * power)
        found = [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
        max_count += 1
    return found
