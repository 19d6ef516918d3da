"""Why a decision was wrong: ground truth replaces one stage after the other, and the rollout
runs again from there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.lab.tasks.task import Decision, StageShare
from pipeline.lab.tasks.touches import NONE, OWN, TRUE, Moment
from pipeline.translation.error_attribution import list_substitutions

POSE_TITLE = "pose estimation"  # what remains with the true touch: the controller's own


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectedEstimate:
    """The controller's estimate with the truth in one more stage."""

    stage: str
    title: str
    estimate: Any


def correct_estimates(
    moments: Sequence[Moment],
    touch: str,
    estimate: Callable[[Sequence[dict[str, object]], Progress], Any],
    truth: Any,
    *,
    progress: Progress = SILENT,
) -> tuple[CorrectedEstimate, ...]:
    """Estimates with the truth in one more stage each, in running order.

    The last is `truth` itself.

    `estimate` reads values in place of stages, one mapping per finger.
    """
    corrected: list[CorrectedEstimate] = []
    if touch != NONE:
        given: list[dict[str, object]] = [{} for _ in moments]
        by_stage = list(zip(*(list_true_stages(moment, touch) for moment in moments), strict=True))
        for done, steps in enumerate(by_stage):
            part = SubProgress(
                progress,
                done / len(by_stage),
                1.0 / len(by_stage),
                f"truth in place of {steps[0][1]}",
            )
            part.step(0.0, "")
            for one, (stage, _, value) in zip(given, steps, strict=True):
                one[stage] = value
            corrected.append(
                CorrectedEstimate(
                    stage=steps[0][0], title=steps[0][1], estimate=estimate(given, part)
                )
            )
    return (*corrected, CorrectedEstimate(stage="pose", title=POSE_TITLE, estimate=truth))


def share_error(
    error_mm: float,
    corrected: Sequence[CorrectedEstimate],
    judge: Callable[[Any], tuple[float, bool]],
) -> tuple[StageShare, ...]:
    """The shares of `error_mm`, which add up to it.

    `judge` returns error and success of an estimate.
    """
    shares: list[StageShare] = []
    left = error_mm
    for one in corrected:
        now, succeeds = judge(one.estimate)
        shares.append(
            StageShare(
                stage=one.stage,
                title=one.title,
                share_mm=left - now,
                remaining_mm=now,
                succeeds=succeeds,
            )
        )
        left = now
    return tuple(shares)


def list_true_stages(
    moment: Moment, touch: str, last: str = "touch_depth"
) -> list[tuple[str, str, object]]:
    """(stage, title, truth) of one finger for the stages that the controller's touch comes from,
    up to `last`.
    """
    last = "depth" if touch in (TRUE, OWN) else last
    translation, results = moment.evaluate(touch, last)
    before = translation.stages[: translation.stages.index(last) + 1]
    truths = translation.read_true_outputs(0)
    return list(
        list_substitutions(
            translation, {name: truths[name] for name in before if name in truths}, results
        )
    )


def describe_decision(decision: Decision) -> str:
    """The error, its two largest shares, and the first truth with which a failed rollout
    succeeds.
    """
    text = f"off by {decision.error_mm:.1f} mm"
    named = [
        f"{part.share_mm:.1f} by {part.title}"
        for part in sorted(decision.shares, key=lambda share: -share.share_mm)[:2]
        if part.share_mm >= 0.05
    ]
    if named:
        text += f", of it {', '.join(named)}"
    if not decision.shares:
        return text
    first = next((part for part in decision.shares if part.succeeds), None)
    return text + (
        f"; with the truth in place of {first.title} it succeeds"
        if first
        else "; it fails with the truth"
    )
