"""Error attribution as a waterfall: each bar begins where the one before it ends."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from PyQt6.QtCore import QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QMouseEvent, QPainter, QPalette
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.lab.tasks.task import Decision
from widgets.style.base import ChoiceBox, PaintedWidget
from widgets.style.run_bar import StartBar
from widgets.style.styling import fill, make_bold, set_spacing
from widgets.style.theme import ThemeColours, to_qcolor

_BAR_SHARE = 0.62  # of a row's height
# of the width
_TITLE_SHARE = 0.26
_VALUE_SHARE = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterfallBar:
    """One row of the waterfall: start and end on the error axis."""

    title: str
    begin: float
    end: float
    is_total: bool = False  # a sum, drawn from 0

    @property
    def change(self) -> float:
        """Change of the remaining error; negative where it decreases."""
        return self.end - self.begin


def make_bars(
    title: str, total: float, parts: Sequence[tuple[str, float]], rest: float | None = None
) -> tuple[WaterfallBar, ...]:
    """Return the rows of the total error, of (title, share) parts from where the one before
    ends, and of the rest.
    """
    rows = [WaterfallBar(title=title, begin=0.0, end=total, is_total=True)]
    left = total
    for name, share in parts:
        rows.append(WaterfallBar(title=name, begin=left, end=left - share))
        left -= share
    if rest is not None:
        rows.append(WaterfallBar(title="the rest", begin=0.0, end=rest, is_total=True))
    return tuple(rows)


class Waterfall(PaintedWidget):
    """Paints `bars` in rows of equal height; a click emits the row."""

    row_clicked = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__("waterfall", "shares of the error")
        self.bars: tuple[WaterfallBar, ...] = ()
        self._unit = ""

    def show_bars(self, shown: tuple[WaterfallBar, ...], unit: str) -> None:
        """Show these rows."""
        self.bars = shown
        self._unit = unit
        self.update()

    def mouseReleaseEvent(self, a0: QMouseEvent | None) -> None:  # noqa: N802
        """Emit the row under the pointer."""
        if a0 is not None and self.bars and self.rect().contains(a0.position().toPoint()):
            self.row_clicked.emit(int(a0.position().y() * len(self.bars) / max(1, self.height())))

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return room for all rows."""
        return QSize(420, 18 * max(5, len(self.bars)))

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint titles at the left, values at the right, bars between them on one axis."""
        if not self.bars:
            return
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        low = min(0.0, *(min(bar.begin, bar.end) for bar in self.bars))
        high = max(1e-9, *(max(bar.begin, bar.end) for bar in self.bars))
        left = _TITLE_SHARE * self.width()
        right = (1.0 - _VALUE_SHARE) * self.width()
        per_unit = (right - left) / (high - low)
        tall = self.height() / len(self.bars)
        for row, bar in enumerate(self.bars):
            top = row * tall
            painter.setPen(self.palette().color(QPalette.ColorRole.WindowText))
            align = Qt.AlignmentFlag.AlignVCenter
            painter.drawText(
                QRectF(4, top, left - 10, tall), align | Qt.AlignmentFlag.AlignRight, bar.title
            )
            value = f"{bar.end:.3f} {self._unit}" if bar.is_total else f"{bar.change:+.3f}"
            painter.drawText(QRectF(right + 6, top, self.width() - right - 8, tall), align, value)
            ends = sorted((bar.begin, bar.end))
            colour = ink.neutral if bar.is_total else ink.accent if bar.change <= 0 else ink.worse
            painter.fillRect(
                QRectF(
                    left + (ends[0] - low) * per_unit,
                    top + 0.5 * (1 - _BAR_SHARE) * tall,
                    max(1.0, (ends[1] - ends[0]) * per_unit),
                    _BAR_SHARE * tall,
                ),
                to_qcolor(colour),
            )


class WaterfallPanel(QWidget):
    """Controls and a sentence over the bars."""

    def __init__(self, control: QWidget, *, at_left: bool = False) -> None:
        super().__init__()
        self.sentence = QLabel()
        self.waterfall = Waterfall()
        self.sentence.setWordWrap(True)
        make_bold(self.sentence)
        head = fill(set_spacing(QHBoxLayout(), 8), (self.sentence, 1))
        head.insertWidget(0 if at_left else 1, control)
        fill(set_spacing(QVBoxLayout(self), 4, (6, 4, 6, 4)), head, (self.waterfall, 1))


class ErrorAttributionPanel(WaterfallPanel):
    """Metric chooser, sentence and waterfall.

    `share_clicked` carries the number of the clicked share.
    """

    share_clicked = pyqtSignal(int)

    def __init__(self) -> None:
        self.metric_box = ChoiceBox("attributed_metric", "metric to attribute")
        super().__init__(self.metric_box, at_left=True)
        self.waterfall.setToolTip(
            "A click on a share pins the truth of its stage in the column's head, or releases it"
        )
        self.waterfall.row_clicked.connect(self._click_row)
        self.show_empty("")

    def _click_row(self, row: int) -> None:
        if not self.waterfall.bars[row].is_total:
            self.share_clicked.emit(row - 1)  # the first row is the whole error

    def offer_metrics(self, names: Mapping[str, str], chosen: str) -> None:
        """Offer the metrics (name -> text) that this frame has; emits no signal."""
        self.metric_box.offer(names, chosen)
        self.metric_box.setEnabled(bool(names))

    def show_empty(self, why: str) -> None:
        """Show why there is no error to attribute."""
        self.sentence.setText(why)
        self.waterfall.show_bars((), "")

    def show_attribution(self, sentence: str, shown: tuple[WaterfallBar, ...], unit: str) -> None:
        """Show an error and its parts."""
        self.sentence.setText(sentence)
        self.waterfall.show_bars(shown, unit)


_SUCCEEDS = "\N{CHECK MARK} succeeds"


class DecisionPanel(WaterfallPanel):
    """Sentence and start of the run over the bars."""

    def __init__(self) -> None:
        self.run_bar = StartBar("attribute", "Attribute")
        super().__init__(self.run_bar)
        self.run_bar.start_button.setToolTip(
            "Run the rollout again with the truth in place of one stage after the other; nothing "
            "is written"
        )

    def show_decision(
        self, sentence: str, decision: Decision | None, *, can_attribute: bool
    ) -> None:
        """Show the shares of a decision, if it has some."""
        self.sentence.setText(sentence)
        self.run_bar.start_button.setEnabled(can_attribute)
        self.waterfall.show_bars(() if decision is None else make_share_bars(decision), "mm")
        shares: Sequence[str] = (
            () if decision is None else [f"{p.title} {p.share_mm:.2f} mm" for p in decision.shares]
        )
        self.waterfall.setAccessibleDescription("; ".join(shares))


def make_share_bars(decision: Decision) -> tuple[WaterfallBar, ...]:
    """Return the error, then each stage's share from where the one before ends.

    () without shares.
    """
    parts = [
        (f"{p.title} {_SUCCEEDS}" if p.succeeds else p.title, p.share_mm) for p in decision.shares
    ]
    return make_bars("error", decision.error_mm, parts) if parts else ()
