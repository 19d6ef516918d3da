"""The verdict: what is wrong with the frame on screen, its largest cause in words, and what mends
it; beside it the figures of the frame and each stage's share of its error.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial

from PyQt6.QtCore import QEvent

from app.document.evaluator import EvaluatedFrame
from app.document.feature import Feature
from app.document.session_controller import SessionController
from pipeline.core.errors import find_uncertain_contact, name_options
from pipeline.core.graph import StageResult
from pipeline.core.values.results import DepthMap
from pipeline.stages.metrics.stage_metrics import METRICS, describe_metric, is_stage_error
from pipeline.stages.stage import TRUTH
from pipeline.translation.error_attribution import (
    DEFAULT_METRIC,
    OUTSIDE_VIEW,
    ErrorAttribution,
    ErrorShare,
    attribute_error,
)
from widgets.frames.error_attribution_panel import make_bars
from widgets.stages.verdict_line import Finding
from widgets.style.base import EventListener
from widgets.style.notification_bar import Choice
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 250  # attribution costs several frames of computation: not while playing or browsing
_NO_ERROR = "This frame has no known error: the recording has no touch of the target."
_NO_TRUTH = "The recording has no touch of the target to compare with."
_LEAST_SHARE = 0.02  # of the error: a smaller share has no bar on its card
_UNSEEN = "the source saw only a part of the object"
# share -> its cause, and what would be without it
_CAUSES = {
    "depth": ("the measured depth of the source", "With the true depth of the source"),
    "cloud": ("the alignment of the two sensors", "With the true alignment"),
    "target_depth": ("the reprojection into the target", "With the true target depth"),
    OUTSIDE_VIEW: (_UNSEEN, "Had the source seen the whole object"),
    "touch": ("the generated touch itself", "With the true touch"),
    "touch_depth": ("the generated touch itself", "With the true touch"),
    "pose": ("the estimated pose itself", "With the true pose"),
}


class VerdictController(Feature):
    """Connects verdict line, cards and inspector with the frame on screen."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.error_attribution
        self._metric = DEFAULT_METRIC
        self._attribution: ErrorAttribution | None = None
        self._timer = make_single_shot_timer(self, _DELAY_MS, self._attribute)
        look = self._window.look
        EventListener(look, self._timer.start, QEvent.Type.Show)
        EventListener(look, self._timer.stop, QEvent.Type.Hide)
        self._panel.metric_box.chosen.connect(self._choose_metric)
        self._panel.share_clicked.connect(self._toggle_truth)
        controller.remedies_changed.connect(self._show)
        look.active_changed.connect(self._show_figures)
        # an error is the verdict while its banner is there
        EventListener(self._window.banner, self._show, QEvent.Type.Show, QEvent.Type.Hide)

    def show_translation(self) -> None:
        """Show no error of the recording before."""
        self._panel.show_empty("")

    def show_frame(self) -> None:
        """Judge it, and attribute its error if it stays."""
        self._attribution = None
        self._panel.show_empty("")
        self._timer.start()
        self._show()

    def _choose_metric(self, metric: str) -> None:
        self._metric = metric
        self._attribute()

    def _attribute(self) -> None:
        controller = self._controller
        latest = controller.latest_frame
        if (
            latest is None
            or self._session.layout.name != "look"
            or self._window.timeline.is_playing
            or not controller.is_idle
        ):
            return
        known = [name for name in latest.metrics if is_stage_error(name)]
        metric = self._metric if self._metric in known else next(iter(known), "")
        self._panel.offer_metrics({name: describe_metric(name) for name in known}, metric)
        if not metric:
            self._panel.show_empty(_NO_ERROR)
            return
        session = self._session
        evaluator = controller.evaluator
        self._panel.show_empty("replacing one stage after the other by its truth…")
        controller.submit_priority(
            lambda report: attribute_error(*evaluator.open_frame(session, report), metric, report),
            self._show_attribution,
        )

    def _show_attribution(self, result: ErrorAttribution | None) -> None:
        if result is None:
            return
        parts = [(part.title, part.share) for part in result.shares]
        self._panel.show_attribution(
            "Where the error comes from",
            make_bars("this frame's error", result.total, parts, result.remainder),
            result.unit,
        )
        self._attribution = result
        self._show()

    def _toggle_truth(self, share: int) -> None:
        """Pin the truth of the stage of a share in its column's head.

        A pinned stage is computed again.
        """
        if self._attribution is not None:
            stage = self._attribution.shares[share].stage
            is_pinned = self._session.methods.get(stage) == TRUTH
            self._controller.choose_method(stage, "" if is_pinned else TRUTH)

    def _show(self) -> None:
        latest = self._controller.latest_frame
        if latest is None:
            return
        self._show_figures()
        self._window.look.filmstrip.show_shares(collect_shares(self._attribution))
        findings = self._list_findings(latest.results)
        state, sentence, cause = judge_frame(latest, findings, self._attribution)
        self._window.verdict.show_verdict(
            state, sentence, cause, findings, (*self._offer_place(), *self._controller.remedies)
        )
        if self._window.is_presenting or not self._window.banner.isHidden():
            self._window.verdict.hide()

    def _list_findings(self, results: Mapping[str, StageResult]) -> list[Finding]:
        """List all warnings and fallbacks; those that every frame has come last."""
        stage = self._controller.catalogue.stage
        common = self._window.frames.model.common_warnings
        found = [
            (f"{stage(name).title.lower()}: {warning}" in common, name, warning)
            for name, result in results.items()
            for warning in (*filter(None, (result.fallback,)), *result.warnings)
        ]
        found.sort(key=lambda one: one[0])
        return [
            Finding(sentence=name_options(f"{stage(name).title}: {warning}"), stage=name)
            for _, name, warning in found
        ]

    def _offer_place(self) -> list[Choice]:
        """Offer to show where the largest share of the error is."""
        worst = None if self._attribution is None else find_largest_share(self._attribution)
        return [] if worst is None else [("Show where", partial(self._show_place, worst.stage))]

    def _show_place(self, stage: str) -> None:
        look = self._window.look
        look.choose_stage(stage)
        look.dims_chosen.emit(look.active_pane, "both")
        self._controller.set_comparison_mode("difference")

    def _show_figures(self, *_: object) -> None:
        """Show the error in contact, and what else is known of the chosen stage."""
        latest = self._controller.latest_frame
        metrics = {} if latest is None else latest.metrics
        chosen = self._window.look.active_stage
        shown: list[tuple[str, str, str]] = []
        for name in sorted(metrics, key=lambda name: name != DEFAULT_METRIC):
            value = metrics[name]
            stage, figure = name.split(".", 1)
            if (name == DEFAULT_METRIC or stage == chosen) and math.isfinite(value):
                metric = METRICS[figure]
                text = f"{value:.3f} {metric.unit}".rstrip()
                shown.append((metric.title, text, metric.meaning))
        self._window.inspector.show_figures(shown)


def judge_frame(
    latest: EvaluatedFrame, findings: Sequence[Finding], attribution: ErrorAttribution | None
) -> tuple[str, str, str]:
    """Return a state, a sentence and its cause."""
    if not latest.results:
        return "", "", ""  # of a layout that computes no stage
    which = f"Frame {latest.index}"
    depth = latest.results["depth"].output if "depth" in latest.results else None
    if isinstance(depth, DepthMap) and not depth.contact.any():
        doubt = find_uncertain_contact(depth.notes)
        if doubt is not None:
            return "warning", f"{which}:", f"{doubt}."
        return "", f"{which} has no contact.", "The target's reference image is the answer."
    error_mm = latest.metrics.get(DEFAULT_METRIC, math.nan)
    if math.isfinite(error_mm):
        is_wrong = bool(findings) or attribution is not None
        return (
            "warning" if is_wrong else "",
            f"{which} is {error_mm:.2f} mm off.",
            describe_cause(attribution, latest.results),
        )
    if findings:
        return "warning", f"{which}:", f"{findings[0].sentence}."
    is_whole = DEFAULT_METRIC.partition(".")[0] in latest.results
    return "", f"{which}: no warning.", _NO_TRUTH if is_whole else ""


def find_largest_share(attribution: ErrorAttribution) -> ErrorShare | None:
    """Return the largest share; None if more remains with the truth in every stage."""
    worst = max(attribution.shares, key=lambda part: part.share, default=None)
    return None if worst is None or worst.share <= max(0.0, attribution.remainder) else worst


def describe_cause(attribution: ErrorAttribution | None, results: Mapping[str, StageResult]) -> str:
    """Return the cause of an error in words: why another method had to answer for the touch, else
    the largest share, with why where the stage says so.
    """
    refused = next((r.fallback for r in results.values() if r.fallback and r.name == "touch"), "")
    parts = [f"{refused}."] if refused else []
    if attribution is not None and attribution.total > 0:
        worst = find_largest_share(attribution)
        stage = attribution.metric.partition(".")[0] if worst is None else worst.stage
        is_unseen = worst is not None and worst.title == OUTSIDE_VIEW
        cause, without = _CAUSES.get(OUTSIDE_VIEW if is_unseen else stage, (stage, ""))
        warnings = results[stage].warnings if stage in results else ()
        reasons = [warning for warning in warnings if ("saw" in warning) == is_unseen]
        share = attribution.remainder if worst is None else worst.share
        if share > attribution.total:
            parts.append(f"{without}: {share:.2f} {attribution.unit} less; other errors cancel it.")
        elif is_unseen:
            parts.append(f"{share / attribution.total:.0%} of it: {next(iter(reasons), cause)}.")
        else:
            why = "; ".join((cause, *(reason.partition(";")[0] for reason in reasons[:1])))
            parts.append(f"{share / attribution.total:.0%} of it: {why}.")
    return name_options(" ".join(parts))


def collect_shares(attribution: ErrorAttribution | None) -> dict[str, tuple[float, str]]:
    """Return stage -> share of the error (1 = all of it) and its value as a text."""
    if attribution is None or attribution.total <= 0:
        return {}
    values: dict[str, float] = {}
    for part in attribution.shares:
        values[part.stage] = values.get(part.stage, 0.0) + part.share
    own = attribution.metric.partition(".")[0]
    values[own] = values.get(own, 0.0) + attribution.remainder
    return {
        stage: (value / attribution.total, f"{value:.3f} {attribution.unit}")
        for stage, value in values.items()
        if abs(value) >= _LEAST_SHARE * attribution.total
    }
