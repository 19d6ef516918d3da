"""Page of the *Track* layout: how the touched object moves over the frames, and its fused surface in 3D."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PyQt6.QtCore import QPointF, QRectF, Qt
from PyQt6.QtGui import QAction, QBrush, QColor, QPainter, QPalette, QPen, QPolygonF
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.base.arrays import Doubles
from pipeline.previews.colours import Rgb
from pipeline.previews.view import StepCurve
from pipeline.tracking.track_record import MOTION, TrackRecord, TrackRow
from widgets.base import ChoiceBox
from widgets.run_bar import StartBar
from widgets.section_plot import compute_segments, compute_ticks, draw_lines
from widgets.steps_panel import StepsPlot
from widgets.styling import fill, make_bold, make_command_button, make_splitter, set_spacing
from widgets.theme import ThemeColours, get_theme_colours, to_qcolor
from widgets.view_3d_panel import View3DPanel

_PLOT_SIZE = 620  # of 1000
_GAP_PX, _MARK_PX = 6.0, 4.0
_FINE_PX, _DOT_PX, _MOST_DOTS = 3.0, 5.0, 120  # step of a drawn curve; dots at the frames of a short track
_WIDEST_NAME = "\N{EM DASH}\N{EM DASH} overlap"  # left of the curves
_PATTERNS = ("1", "1110", "10")  # dashes of the first, second and third curve of a strip
_LEAST_SPAN = {"mm": 0.1, "°": 0.5, "": 1.0}  # of a strip: noise does not fill it
_MAX_FRAME_LABELS = 8


@dataclass(frozen=True, slots=True)
class _Strip:
    title: str
    unit: str
    curves: Sequence[tuple[str, str]]  # field of a row, and its name


_STRIPS = (
    _Strip("translation", "mm", tuple(zip(MOTION[:3], "xyz", strict=True))),
    _Strip("rotation", "°", tuple(zip(MOTION[3:], "xyz", strict=True))),
    _Strip("predicted uncertainty", "mm", (("std_mm", ""),)),
    _Strip("inliers, overlap", "", (("agreement", "inliers"), ("overlap", "overlap"))),
)


class TrackPlot(StepsPlot):
    """One strip per quantity over the frames; click, drag or arrow keys choose a frame by its row."""

    preferred_px = 560, 380

    def __init__(self) -> None:
        super().__init__("track_plot", "motion of the object over the frames")
        self.setToolTip("Motion since the first frame; hatched: lost, grey: no contact, triangles: key frames")
        self.rows: tuple[TrackRow, ...] = ()
        self._keys = frozenset[int]()
        self._values: dict[str, Doubles] = {}

    def show_track(self, rows: Sequence[TrackRow], key_frames: Sequence[int]) -> None:
        """Show these frames, and which are key frames."""
        self.rows, self._keys = tuple(rows), frozenset(key_frames)
        names = [name for strip in _STRIPS for name, _ in strip.curves]
        self._values = {name: np.array([getattr(row, name) for row in rows], dtype=np.float64) for name in names}
        self.show_curves(
            [StepCurve(name=_WIDEST_NAME, unit="", values=tuple(float(row.frame) for row in rows))] if rows else (), ()
        )

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint states, strips, key frames, frame numbers and the current frame."""
        if not self.rows:
            return
        palette = self.palette()
        left, line_px = self.compute_step_x_px(0), self.fontMetrics().height() + 2.0
        right = max(left + 1.0, self.compute_step_x_px(len(self.rows) - 1))
        room = QRectF(left, line_px, right - left, self.height() - 2 * line_px)
        self._draw_states(painter, room)
        tall = (room.height() - (line_px + _GAP_PX) * (len(_STRIPS) - 1)) / len(_STRIPS)
        for k, strip in enumerate(_STRIPS):
            self._draw_strip(
                painter, strip, QRectF(room.left(), room.top() + k * (tall + line_px + _GAP_PX), room.width(), tall)
            )
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(palette.color(QPalette.ColorRole.WindowText))
        for at in (k for k, row in enumerate(self.rows) if row.frame in self._keys):
            x = self.compute_step_x_px(at)
            corners = QPointF(x - _MARK_PX, 0), QPointF(x + _MARK_PX, 0), QPointF(x, 1.7 * _MARK_PX)
            painter.drawPolygon(QPolygonF(corners))
        if 0 <= self.current_step < len(self.rows):
            painter.setPen(QPen(to_qcolor(ink.accent), 2))
            x = self.compute_step_x_px(self.current_step)
            painter.drawLine(QPointF(x, 0), QPointF(x, room.bottom()))
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        for at in {round(t) for t in compute_ticks(0.0, len(self.rows) - 1.0, _MAX_FRAME_LABELS)}:
            box = QRectF(self.compute_step_x_px(at) - 40, room.bottom() + 2, 80, line_px)
            painter.drawText(box, Qt.AlignmentFlag.AlignCenter, str(self.rows[at].frame))
        painter.drawText(QRectF(4, room.bottom() + 2, left, line_px), 0, "frame")

    def _draw_states(self, painter: QPainter, room: QRectF) -> None:
        """Paint a band over every frame that is not tracked: hatched where lost, grey without contact."""
        half = 0.5 * room.width() / max(1, len(self.rows) - 1)
        lost = QBrush(to_qcolor(get_theme_colours(self.palette()).worse, 130), Qt.BrushStyle.BDiagPattern)
        bare = QBrush(QColor(self.palette().color(QPalette.ColorRole.Midlight)))
        for at, row in enumerate(self.rows):
            if row.state != "tracked":
                left = max(room.left(), self.compute_step_x_px(at) - half)
                right = min(room.right(), self.compute_step_x_px(at) + half)
                box = QRectF(left, room.top(), max(1.0, right - left), room.height())
                painter.fillRect(box, lost if row.state == "lost" else bare)

    def _draw_strip(self, painter: QPainter, strip: _Strip, room: QRectF) -> None:
        palette = self.palette()
        low, high = self._find_limits(strip)
        line_px = self.fontMetrics().height() + 2.0
        words = palette.color(QPalette.ColorRole.WindowText)
        painter.setPen(words)
        title = f"{strip.title}, {strip.unit}" if strip.unit else strip.title
        painter.drawText(QRectF(4, room.top() - line_px, self.width(), line_px), 0, title)
        right = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        for value in compute_ticks(low, high, max(2, int(room.height() / 22))):
            y = room.bottom() - room.height() * (value - low) / (high - low)
            painter.setPen(QPen(palette.color(QPalette.ColorRole.Mid), 1, Qt.PenStyle.DotLine))
            painter.drawLine(QPointF(room.left(), y), QPointF(room.right(), y))
            painter.setPen(words)
            painter.drawText(QRectF(room.left() - 50, y - 8, 45, 16), right, f"{value:.4g}")
        x = np.array([self.compute_step_x_px(k) for k in range(len(self.rows))])
        fine = np.linspace(x[0], x[-1], max(len(x), int((x[-1] - x[0]) / _FINE_PX)))
        for k, (name, legend) in enumerate(strip.curves):
            colour, pattern = to_qcolor(self._curve_colour(strip, k)), _PATTERNS[k]
            painter.setPen(QPen(colour, 1.8))
            y = room.bottom() - room.height() * (self._values[name] - low) / (high - low)
            draw_lines(painter, compute_segments(fine, np.interp(fine, x, y), pattern))
            if len(x) <= _MOST_DOTS:
                painter.setPen(QPen(colour, _DOT_PX, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
                painter.drawPoints(QPolygonF([QPointF(*at) for at in zip(x, y, strict=True) if math.isfinite(at[1])]))
                painter.setPen(QPen(colour, 1.8))
            if legend:
                row = QRectF(4, room.top() + line_px * k, room.left(), line_px)
                draw_lines(painter, compute_segments(np.linspace(4, 24, 9), np.full(9, row.center().y()), pattern))
                painter.drawText(row.translated(26, 0), Qt.AlignmentFlag.AlignVCenter, legend)

    def _curve_colour(self, strip: _Strip, number: int) -> Rgb:
        ink = get_theme_colours(self.palette())
        return (
            ink.axes[number] if strip.unit in ("mm", "°") and len(strip.curves) > 1 else (ink.accent, ink.worse)[number]
        )

    def _find_limits(self, strip: _Strip) -> tuple[float, float]:
        known = np.concatenate([self._values[name] for name, _ in strip.curves])
        known = known[np.isfinite(known)]
        low, high = min(0.0, float(known.min(initial=0.0))), max(0.0, float(known.max(initial=0.0)))
        missing = _LEAST_SPAN[strip.unit] - (high - low)
        high = high + missing if missing > 0 and not math.isclose(missing, 0.0) else high
        return low, high


class TrackPage(QWidget):
    """Stage and start over a sentence over plot and surface."""

    def __init__(self) -> None:
        super().__init__()
        self.stage_box, self.run_bar = ChoiceBox("tracked_stage", "touch to follow"), StartBar("track", "Track")
        self.plot, self.scene, self.sentence = TrackPlot(), View3DPanel(), QLabel()
        self.stage_box.setToolTip("Membrane to follow: the source's, or that of the generated touch")
        make_bold(self.sentence)
        self.sentence.setTextFormat(Qt.TextFormat.PlainText)
        self.sentence.setWordWrap(True)
        self.scene.view.setAccessibleName("touched surface")
        self.scene.view.setMinimumSize(220, 160)
        self.scene.caption.set_texts("sensor frame of the first frame, mm")
        self._head = fill(set_spacing(QHBoxLayout(), 6), QLabel("follow"), self.stage_box, self.run_bar, 1)
        split = make_splitter(Qt.Orientation.Horizontal, (self.plot, 1), (self.scene, 1))
        split.setObjectName("track_split")
        split.setSizes([_PLOT_SIZE, 1000 - _PLOT_SIZE])
        fill(set_spacing(QVBoxLayout(self), 4, (6, 4, 6, 2)), self._head, self.sentence, (split, 1))
        self.clear("")

    def add_command(self, action: QAction) -> None:
        """Add a command to the controls."""
        self._head.addWidget(make_command_button(action))

    def offer_stages(self, stages: Mapping[str, str]) -> None:
        """Offer name -> title of the stages whose membrane can be followed."""
        self.run_bar.start_button.setEnabled(bool(stages))
        self.stage_box.offer(stages)

    def show_record(self, record: TrackRecord, name: str) -> None:
        """Show a track and its summary."""
        self.plot.show_track(record.rows, record.key_frames)
        self.sentence.setText(f"{name}: {describe_record(record)}")
        self.scene.legend.setText("fused surface and the sensor's path on it" if record.patch is not None else "")
        self.scene.setVisible(record.patch is not None)

    def clear(self, text: str) -> None:
        """Show no track, and why."""
        self.plot.show_track((), ())
        self.sentence.setText(text)
        self.scene.hide()


def describe_record(record: TrackRecord) -> str:
    """Return the counts of a track, its drift, and what was not measured."""
    counts = [f"{record.count('tracked')} of {len(record.rows)} frames tracked", f"{record.count('lost')} lost",
              f"{record.count('no contact')} without contact"]  # fmt: skip
    counts += [f"{len(record.problems)} not read"] if record.problems else []
    counts += [f"{record.n_parts} parts"] if record.n_parts > 1 else []
    counts += [f"key frames: {len(record.key_frames)}", f"closed loops: {record.n_loops}"]
    text = ", ".join(counts)
    if record.error is not None:
        text += (
            f"; largest error {record.error.drift_mm:.3f} mm and {record.error.drift_deg:.2f}° over "
            f"{record.error.path_mm:.1f} mm and {record.error.turned_deg:.0f}°"
        )
    if record.weak_directions:
        text += f"; not measured in some frames: {', '.join(record.weak_directions[:3])}"
    return text
