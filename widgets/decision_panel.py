"""Error attribution of one decision of a rollout: a sentence, bars, and the run that computes them."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from pipeline.tasks.task import Decision
from widgets.error_attribution_panel import Waterfall, WaterfallBar, make_bars
from widgets.run_bar import StartBar
from widgets.styling import make_bold, set_spacing

_SUCCEEDS = "\N{CHECK MARK} succeeds"


class DecisionPanel(QWidget):
    """Sentence and start of the run over the bars."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.sentence, self.waterfall, self.run_bar = QLabel(), Waterfall(), StartBar("attribute", "Attribute")
        self.run_bar.start_button.setToolTip(
            "Run the rollout again with the truth in place of one stage after the other; nothing is written"
        )
        self.sentence.setWordWrap(True)
        make_bold(self.sentence)
        head = set_spacing(QHBoxLayout(), 6)
        head.addWidget(self.sentence, 1)
        head.addWidget(self.run_bar)
        layout = set_spacing(QVBoxLayout(self), 2, (6, 2, 6, 2))
        layout.addLayout(head)
        layout.addWidget(self.waterfall, 1)

    def show_decision(self, sentence: str, decision: Decision | None, *, can_attribute: bool) -> None:
        """Show the shares of a decision, if it has some."""
        self.sentence.setText(sentence)
        self.run_bar.start_button.setEnabled(can_attribute)
        self.waterfall.show_bars(() if decision is None else make_share_bars(decision), "mm")
        shares: Sequence[str] = () if decision is None else [f"{p.title} {p.share_mm:.2f} mm" for p in decision.shares]
        self.waterfall.setAccessibleDescription("; ".join(shares))


def make_share_bars(decision: Decision) -> tuple[WaterfallBar, ...]:
    """Return the error, then each stage's share from where the one before ends; () without shares."""
    parts = [(f"{p.title} {_SUCCEEDS}" if p.succeeds else p.title, p.share_mm) for p in decision.shares]
    return make_bars("error", decision.error_mm, parts) if parts else ()
