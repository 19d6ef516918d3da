"""Attribution of an error to stages: ground truth replaces one stage after the other, and the error
is measured again.

The decrease when the source's depth is replaced is the share of depth, and so on along the route.
The target depth is replaced twice, first only where it is visible to the source: the rest was
outside the source's view, and no method that knows only the touch can recover it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Mask, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResults
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.results import TargetDepth
from pipeline.stages.metrics.stage_metrics import METRICS
from pipeline.translation.translate import Translation

DEFAULT_METRIC = "touch_depth.contact_mae_mm"  # error of the target's membrane in contact
OUTSIDE_VIEW = "outside the source's view"
_VISIBLE_TITLE = "reprojection"


@frozen
class ErrorShare:
    """Decrease of an error when one more stage is replaced by ground truth.

    Negative if it increases.
    """

    stage: str
    title: str
    share: float  # in the metric's unit
    remaining: float  # the error that remains with the truth so far


@frozen
class ErrorAttribution:
    """An error of one frame as a sum: `total` = all shares + `remainder`."""

    frame: int
    metric: str  # as in a frame's metrics, "stage.metric"
    unit: str
    total: float
    shares: tuple[ErrorShare, ...]
    remainder: float  # with truth in every stage before the metric's own

    @property
    def summary(self) -> str:
        """The error and its largest share."""
        text = f"{self.total:.2f} {self.unit}"
        worst = self._largest_share
        if worst is None:
            return text
        if worst.share > self.total:
            return (
                f"{text}; without {worst.title} {worst.share:.2f} less, which other errors cancel"
            )
        return f"{text}, of it {worst.share:.2f}: {worst.title}"

    @property
    def main_cause(self) -> str:
        """Title of the stage with the largest share.

        The metric's own stage if more remains with all truth.
        """
        worst = self._largest_share
        return self.metric.partition(".")[0].replace("_", " ") if worst is None else worst.title

    @property
    def _largest_share(self) -> ErrorShare | None:
        """The largest share; None if more than it remains with truth in every stage."""
        worst = max(self.shares, key=lambda part: part.share, default=None)
        return None if worst is None or worst.share <= max(0.0, self.remainder) else worst


def attribute_error(
    translation: Translation,
    frame: int,
    figure: str = DEFAULT_METRIC,
    progress: Progress = SILENT,
) -> ErrorAttribution | None:
    """Return the shares of a frame's error by `figure`.

    None where that metric is unknown for this frame.

    Raises SettingProblem for an unknown metric, or one without a better direction.
    """
    stage, _, name = figure.partition(".")
    if name not in METRICS or stage not in translation.stages:
        known = sorted(f"{s}.*" for s in translation.stages)
        raise SettingProblem(
            f"no metric {figure!r} on this route; a metric is stage.name, as {', '.join(known)}"
        )
    if METRICS[name].better != "lower":
        raise SettingProblem(f"{figure} is not an error; choose a metric of which lower is better")

    def evaluate_metric(part: Progress) -> tuple[StageResults, float | None]:
        results = translation.evaluate(at_hand, [stage], part, given=given)
        return results, translation.compute_metrics(results, frame).get(figure)

    at_hand = translation.stream.frame(translation.check_index(frame))
    given = dict[str, object]()
    truths = translation.read_true_outputs(frame)
    before = translation.stages[: translation.stages.index(stage)]
    each = 1.0 / (2 + len(before))
    results, total = evaluate_metric(SubProgress(progress, 0.0, each))
    if total is None:
        return None
    steps = tuple(
        list_substitutions(
            translation, {name: truths[name] for name in before if name in truths}, results
        )
    )
    parts: list[ErrorShare] = []
    left = total
    for index, (of, title, value) in enumerate(steps, start=1):
        given[of] = value
        _, now = evaluate_metric(SubProgress(progress, index * each, each, title))
        if now is None:
            break
        parts.append(ErrorShare(stage=of, title=title, share=left - now, remaining=now))
        left = now
    return ErrorAttribution(
        frame=frame,
        metric=figure,
        unit=METRICS[name].unit,
        total=total,
        shares=tuple(parts),
        remainder=left,
    )


def list_substitutions(
    translation: Translation, truths: Mapping[str, object], results: StageResults
) -> Iterator[tuple[str, str, object]]:
    """Yield (stage, title, truth) in running order.

    The target depth first where the source sees it, then whole.
    """
    for name, value in truths.items():
        made = results[name].output if name in results else None
        if isinstance(value, TargetDepth) and isinstance(made, TargetDepth):
            yield name, _VISIBLE_TITLE, _restrict(value, made.in_view)
            yield name, OUTSIDE_VIEW, value
        else:
            yield name, translation.catalogue.stage(name).title.lower(), value


def _restrict(view: TargetDepth, visible: Mask) -> TargetDepth:
    """True target depth restricted to what is visible to the source."""
    contact = view.contact & visible
    return replace(
        view,
        contact=freeze(contact),
        depth_mm=freeze(np.where(contact, view.depth_mm, np.float32(np.nan))),
        indentation_mm=freeze(np.where(contact, view.indentation_mm, np.float32(0.0))),
        in_view=visible,
    )
