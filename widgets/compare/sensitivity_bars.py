"""Sensitivity bars: how much each metric of the score changes per 0.1 mm or 0.1 degrees of each
axis.
"""

from collections.abc import Sequence

from PyQt6.QtCore import QRectF, Qt
from PyQt6.QtGui import QPainter

from pipeline.translation.alignment.score import UNIT_STEP, ScoreChange, Sensitivity
from widgets.style.base import FIXED, PaintedWidget
from widgets.style.theme import ThemeColours, to_qcolor

# title, unit, digits, whether larger is better
_FIGURES = (("depth", "mm", 3, False), ("edge", "px", 2, False), ("IoU", "", 3, True))
_FULL_IOU = 0.02
_NEARER = "\N{BLACK UP-POINTING TRIANGLE}"
_FARTHER = "\N{BLACK DOWN-POINTING TRIANGLE}"
_CELL_ROOM_PX = 10  # padding of a cell
_LEFT = Qt.AlignmentFlag.AlignVCenter
_RIGHT = Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignRight
_TIP = (
    "change of the score per {step:g} mm or {step:g}° along each axis, mean of either side; the "
    "triangle shows "
    "whether raising or lowering the axis improves it, none at the optimum; bars are full at {full}"
)


class SensitivityBars(PaintedWidget):
    """One row per axis, one column per metric: a bar, its number and the direction that improves
    it.
    """

    def __init__(self) -> None:
        super().__init__("sensitivity", "sensitivity of the axes", down=FIXED)
        self.axes: tuple[Sensitivity, ...] = ()  # the axes on display
        self.preferred_px = 200, 7 * self._row_px()  # a header and six rows
        self._full = (UNIT_STEP, 1.0, _FULL_IOU)
        wide = self.fontMetrics().horizontalAdvance
        widest = max(wide(f"{_NEARER} 0.000"), wide("depth mm")) + _CELL_ROOM_PX
        self.setMinimumWidth(self._left_px() + len(_FIGURES) * widest)
        self.set_pixel_size(UNIT_STEP)

    def set_pixel_size(self, pixel_mm: float) -> None:
        """Set the change at which a bar is full, that of a surface that moves as far as the
        alignment does.
        """
        self._full = (UNIT_STEP, UNIT_STEP / pixel_mm, _FULL_IOU)
        names = zip(_FIGURES, self._full, strict=True)
        full = ", ".join(f"{name} {limit:.2g} {unit}".strip() for (name, unit, *_), limit in names)
        self.setToolTip(_TIP.format(step=UNIT_STEP, full=full))

    def show_sensitivities(self, axes: Sequence[Sensitivity]) -> None:
        """Show these axes; none clears the table."""
        self.axes = tuple(axes)
        rows = [
            f"{s.axis}: " + ", ".join(_format_change(c, i) for i, c in enumerate(_changes(s)))
            for s in self.axes
        ]
        self.setAccessibleDescription("; ".join(rows))
        self.update()

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint header and rows."""
        left = self._left_px()
        width = (self.width() - left) / len(_FIGURES)
        line = QRectF(0, 0, self.width() - 4, self._row_px())
        soft, text = self.palette().placeholderText().color(), self.palette().text().color()
        cells = [
            line.adjusted(left + i * width, 0, (i + 1 - len(_FIGURES)) * width, 0)
            for i in range(len(_FIGURES))
        ]
        painter.setPen(soft)
        painter.drawText(line, _LEFT, "per")
        for cell, (name, unit, *_) in zip(cells, _FIGURES, strict=True):
            painter.drawText(cell, _RIGHT, f"{name} {unit}".strip())
        for axis in self.axes:
            line.translate(0, line.height())
            painter.setPen(text)
            painter.drawText(line, _LEFT, axis.axis)
            painter.setPen(soft)
            step = f"{UNIT_STEP:g}{'°' if axis.unit == 'deg' else ' mm'}"
            name_px = self.fontMetrics().horizontalAdvance("rx  ")
            painter.drawText(line.adjusted(name_px, 0, 0, 0), _LEFT, step)
            painter.setPen(text)
            for i, change in enumerate(_changes(axis)):
                cell = cells[i].translated(0, line.top()).adjusted(0, 1, 0, -1)
                painter.fillRect(cell, to_qcolor(ink.gauge_background))
                bar = QRectF(cell)
                bar.setWidth(min(1.0, (change.magnitude or 0.0) / self._full[i]) * cell.width())
                painter.fillRect(bar, to_qcolor(ink.sensitivity))
                painter.drawText(cell.adjusted(2, 0, -3, 0), _RIGHT, _format_change(change, i))

    def _left_px(self) -> int:
        """Return the width of an axis' name and step."""
        return self.fontMetrics().horizontalAdvance(f"rx  {UNIT_STEP:g} mm") + 8

    def _row_px(self) -> int:
        return self.fontMetrics().height() + 4


def _changes(axis: Sensitivity) -> tuple[ScoreChange, ScoreChange, ScoreChange]:
    return axis.depth_mm, axis.edge_px, axis.iou


def _format_change(change: ScoreChange, figure: int) -> str:
    """Return the size of a change, and whether raising or lowering the axis improves the metric
    unless both are about as bad.
    """
    if change.magnitude is None:
        return "-"
    *_, digits, more_is_better = _FIGURES[figure]
    number = f"{change.magnitude:.{digits}f}"
    if not float(number) or change.slope is None or abs(change.slope) < 0.5 * change.magnitude:
        return number
    return f"{_NEARER if (change.slope > 0) == more_is_better else _FARTHER} {number}"
