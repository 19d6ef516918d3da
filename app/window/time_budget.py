"""The Timings tab: what every stage of a frame costs, and which to skip to play at the target rate."""

from collections.abc import Iterable
from dataclasses import replace

from PyQt6.QtCore import QObject

from app.window.session_controller import SessionController
from pipeline.engine.time_budget import StageClock, TimeBudget
from widgets.timings_panel import BudgetPart, TimingRow

_NAMED = 3  # stages that the sentence names, the slowest first
_SKIPPED = "skipped by you"


class TimeBudgetController(QObject):
    """Connects the tab with the frames on screen and the layout's skipped stages."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.timings
        self._clock, self._offer = StageClock(), frozenset[str]()
        self._of: tuple[object, ...] = ()  # recording and sensors that the times are of
        controller.frame_shown.connect(self._record)
        self._panel.target_changed.connect(self._show)
        self._panel.stage_toggled.connect(self._toggle)
        self._panel.skip_requested.connect(lambda: self._skip(self._offer))

    def _record(self, _: int) -> None:
        latest, session = self._controller.latest_frame, self._controller.session
        opened = self._controller.views.translation
        of = () if opened is None else (opened.request.recording, opened.source.name, opened.target.name)
        if of != self._of:
            self._clock, self._of = StageClock(), of
        for result in () if latest is None else latest.results.values():
            if result.method is not None:
                self._clock.record(result, session.get_params(result.method))
        self._show()

    def _show(self) -> None:
        latest, opened = self._controller.latest_frame, self._controller.views.translation
        if latest is None or opened is None:
            self._panel.show_budget("", (), "")
            return
        stage, layout = opened.catalogue.stage, self._controller.session.layout
        everything = self._clock.compute_budget(opened.methods)
        shown = everything.without(frozenset(everything.times_ms) - latest.results.keys())
        rows = [
            TimingRow(
                name=r.name, title=stage(r.name).title, state=r.state, time_ms=r.ms, notes=r.notes,
                median_ms=everything.times_ms.get(r.name), share=shown.get_share(r.name),
            )
            for r in latest.results.values()
        ]  # fmt: skip
        rows += [
            TimingRow(name=name, title=stage(name).title, state="skipped", notes=(_SKIPPED,),
                      median_ms=everything.times_ms.get(name))
            for name in opened.stages if name in layout.skips and name not in latest.results
        ]  # fmt: skip
        self._panel.show_rows(tuple(rows), can_skip=layout.can_skip)
        skip = shown.find_skip(self._panel.target_hz) if layout.can_skip else frozenset[str]()
        self._offer = skip or frozenset()
        parts = tuple(BudgetPart(title=stage(name).title.lower(), time_ms=ms) for name, ms in shown.times_ms.items())
        offer = f"Skip {self._join_titles(self._offer)}" if self._offer else ""
        self._panel.show_budget(self._describe(shown, skip), parts, offer)

    def _describe(self, budget: TimeBudget, skip: frozenset[str] | None) -> str:
        """Return "depth 60 %, pose 25 %: 9 frames/s; without pose 20"; "" before the first computed frame."""
        if not budget.times_ms:
            return ""
        slowest = sorted(budget.times_ms, key=lambda name: -budget.times_ms[name])[:_NAMED]
        shares = ", ".join(f"{self._join_titles((name,))} {100 * budget.get_share(name):.0f} %" for name in slowest)
        text = f"{shares}: {_format_rate(budget.rate_hz)} frames/s"
        if skip:
            return f"{text}; without {self._join_titles(skip)} {_format_rate(budget.without(skip).rate_hz)}"
        return text if skip is not None else f"{text}; no skip reaches the target"

    def _join_titles(self, stages: Iterable[str]) -> str:
        names = set(stages)
        titles = [s.title.lower() for s in self._controller.catalogue.stages if s.name in names]
        return " and ".join(part for part in (", ".join(titles[:-1]), *titles[-1:]) if part)

    def _toggle(self, stage: str, on: bool) -> None:
        if not on:
            self._skip(frozenset((stage,)))
            return
        needed = {stage}
        for method in reversed(self._controller.methods):
            if method.stage in needed:
                needed.update(method.reads)
        self._choose(frozenset(self._controller.session.layout.skipped_stages) - needed, f"compute {stage}")

    def _skip(self, stages: frozenset[str]) -> None:
        budget = self._clock.compute_budget(self._controller.methods)
        below = frozenset[str]().union(*(budget.find_dependents(stage) for stage in stages))
        self._choose(below.union(self._controller.session.layout.skipped_stages), f"skip {self._join_titles(stages)}")

    def _choose(self, skipped: frozenset[str], words: str) -> None:
        names = tuple(s.name for s in self._controller.catalogue.stages if s.name in skipped)
        layout = replace(self._controller.session.layout, skipped_stages=names)
        if {method.stage for method in self._controller.methods} <= skipped:
            self._show()  # one stage remains: the tick comes back
            return
        self._controller.change(words, layout=layout)


def _format_rate(rate_hz: float) -> str:
    return f"{rate_hz:.1f}" if rate_hz < 10 else f"{rate_hz:.0f}"
