"""Error attribution of one decision of a rollout: a sentence, bars, and the run that computes them."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.tasks.task import Decision
from widgets.error_attribution_panel import WaterfallBar, WaterfallPanel, make_bars
from widgets.run_bar import StartBar

_SUCCEEDS = "\N{CHECK MARK} succeeds"


class DecisionPanel(WaterfallPanel):
    """Sentence and start of the run over the bars."""

    def __init__(self) -> None:
        self.run_bar = StartBar("attribute", "Attribute")
        super().__init__(self.run_bar)
        self.run_bar.start_button.setToolTip(
            "Run the rollout again with the truth in place of one stage after the other; nothing is written"
        )

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
