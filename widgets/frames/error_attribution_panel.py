"""Error attribution as a waterfall: each bar begins where the one before it ends."""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QMouseEvent, QPainter
from PyQt6.QtWidgets import QSizePolicy, QWidget

from pipeline.core.frozen import frozen
from pipeline.lab.tasks.task import Decision
from widgets.style.base import ChoiceBox, PaintedWidget
from widgets.style.run_bar import StartBar
from widgets.style.styling import make_bold, make_column, make_text
from widgets.style.theme import ThemeColours, to_qcolor

_BAR_PX = 8
_BETWEEN_PX = 6


@frozen
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
    for name, share in parts:
        left = rows[-1].end
        rows.append(WaterfallBar(title=name, begin=left, end=left - share))
    if rest is not None:
        rows.append(WaterfallBar(title="left with all truth", begin=0.0, end=rest, is_total=True))
    return tuple(rows)


class Waterfall(PaintedWidget):
    """Paints `bars` in rows of equal height; a click emits the row."""

    row_clicked = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__("waterfall", "shares of the error", down=QSizePolicy.Policy.Minimum)
        self.bars: tuple[WaterfallBar, ...] = ()
        self._unit = ""

    def show_bars(self, shown: tuple[WaterfallBar, ...], unit: str) -> None:
        """Show these rows."""
        self.bars = shown
        self._unit = unit
        self.updateGeometry()
        self.update()

    def mouseReleaseEvent(self, a0: QMouseEvent | None) -> None:  # noqa: N802
        """Emit the row under the pointer."""
        if a0 is not None and self.bars and self.rect().contains(a0.position().toPoint()):
            self.row_clicked.emit(min(int(a0.position().y() / self._row_px), len(self.bars) - 1))

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return room for all rows, of two lines each."""
        return QSize(240, self._row_px * len(self.bars))

    @property
    def _row_px(self) -> int:
        return self.fontMetrics().height() + _BAR_PX + _BETWEEN_PX

    def paint(self, painter: QPainter, ink: ThemeColours) -> None:
        """Paint title and value of each row over its bar; all bars have one axis."""
        if not self.bars:
            return
        ends = [end for bar in self.bars for end in (bar.begin, bar.end)]
        low = min(0.0, *ends)
        per_unit = (self.width() - 8) / (max(1e-9, *ends) - low)
        line_px = self.fontMetrics().height()
        painter.setPen(self.palette().windowText().color())
        for row, bar in enumerate(self.bars):
            line = QRectF(4, row * self._row_px, self.width() - 8, line_px)
            painter.drawText(line, Qt.AlignmentFlag.AlignLeft, bar.title)
            colour = ink.accent if bar.change <= 0 else ink.worse
            value = f"{abs(bar.change):.3f} {'less' if bar.change <= 0 else 'more'}"
            if bar.is_total:
                colour, value = ink.neutral, f"{bar.end:.3f} {self._unit}"
            painter.drawText(line, Qt.AlignmentFlag.AlignRight, value)
            left = 4 + (min(bar.begin, bar.end) - low) * per_unit
            wide = max(1.0, abs(bar.change) * per_unit)
            painter.fillRect(QRectF(left, line.bottom(), wide, _BAR_PX), to_qcolor(colour))


class WaterfallPanel(QWidget):
    """Controls and a sentence over the bars."""

    def __init__(self, control: QWidget) -> None:
        super().__init__()
        self.sentence = make_bold(make_text())
        self.waterfall = Waterfall()
        make_column(4, self.sentence, control, (self.waterfall, 1), on=self)


class ErrorAttributionPanel(WaterfallPanel):
    """Metric chooser, sentence and waterfall.

    `share_clicked` carries the number of the clicked share.
    """

    share_clicked = pyqtSignal(int)

    def __init__(self) -> None:
        self.metric_box = ChoiceBox("attributed_metric", "metric to attribute", is_narrow=True)
        super().__init__(self.metric_box)
        self.waterfall.setToolTip(
            "How much less or more the error is with the truth in one stage after the other; a "
            "click computes the frame with the truth of that stage, or without it again"
        )
        self.waterfall.row_clicked.connect(self._click_row)
        self.offer_metrics({}, "")
        self.show_empty("")

    def _click_row(self, row: int) -> None:
        if not self.waterfall.bars[row].is_total:
            self.share_clicked.emit(row - 1)  # the first row is the whole error

    def offer_metrics(self, names: Mapping[str, str], chosen: str) -> None:
        """Offer the metrics (name -> text) that this frame has, if any; emits no signal."""
        self.metric_box.offer(names, chosen)
        self.metric_box.setVisible(bool(names))

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
