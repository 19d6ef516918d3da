"""Error attribution of one decision of a rollout: a sentence, bars, and the run that computes them."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from pipeline.tasks.task import Decision
from widgets.error_attribution_panel import Waterfall, WaterfallBar
from widgets.styling import make_bold, set_spacing

_SUCCEEDS = "\N{CHECK MARK} succeeds"


class DecisionPanel(QWidget):
    """`attribution_requested` runs the rollout again, `cancel_requested` ends that."""

    attribution_requested = pyqtSignal()
    cancel_requested = pyqtSignal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._sentence, self.waterfall, self._bar = QLabel(), Waterfall(), QProgressBar()
        self.attribute_button, self.cancel_button = QPushButton("Attribute"), QPushButton("Cancel")
        self.attribute_button.setObjectName("attribute_decision")
        self.attribute_button.setToolTip(
            "Run the rollout again with the truth in place of one stage after the other; nothing is written"
        )
        self.cancel_button.setObjectName("attribute_cancel")
        self.waterfall.setAccessibleName("shares of the error")
        self._bar.setRange(0, 1000)
        self._bar.setTextVisible(False)
        self._bar.setFixedWidth(120)
        self._sentence.setWordWrap(True)
        make_bold(self._sentence)
        head = set_spacing(QHBoxLayout(), 6)
        head.addWidget(self._sentence, 1)
        for widget in (self._bar, self.cancel_button, self.attribute_button):
            head.addWidget(widget)
        layout = set_spacing(QVBoxLayout(self), 2, (6, 2, 6, 2))
        layout.addLayout(head)
        layout.addWidget(self.waterfall, 1)
        self.attribute_button.clicked.connect(self.attribution_requested)
        self.cancel_button.clicked.connect(self.cancel_requested)
        self.show_progress(None)

    @property
    def sentence(self) -> str:
        """The sentence about the decision."""
        return self._sentence.text()

    def show_progress(self, fraction: float | None, text: str = "") -> None:
        """Show how far the run is; None hides it."""
        for widget in (self._bar, self.cancel_button):
            widget.setVisible(fraction is not None)
        self.attribute_button.setVisible(fraction is None)
        if fraction is not None:
            self._bar.setValue(round(1000 * fraction))
            self._bar.setToolTip(text)
            self._sentence.setText(text)

    def show_decision(self, sentence: str, decision: Decision | None, *, can_attribute: bool) -> None:
        """Show the shares of a decision, if it has some."""
        self._sentence.setText(sentence)
        self.attribute_button.setEnabled(can_attribute)
        self.waterfall.show_bars(() if decision is None else make_share_bars(decision), "mm")
        shares: Sequence[str] = () if decision is None else [f"{p.title} {p.share_mm:.2f} mm" for p in decision.shares]
        self.waterfall.setAccessibleDescription("; ".join(shares))


def make_share_bars(decision: Decision) -> tuple[WaterfallBar, ...]:
    """Return the error, then each stage's share from where the one before ends; () without shares."""
    if not decision.shares:
        return ()
    bars = [WaterfallBar(title="error", begin=0.0, end=decision.error_mm, is_total=True)]
    left = decision.error_mm
    for part in decision.shares:
        title = f"{part.title} {_SUCCEEDS}" if part.succeeds else part.title
        bars.append(WaterfallBar(title=title, begin=left, end=left - part.share_mm))
        left -= part.share_mm
    return tuple(bars)
