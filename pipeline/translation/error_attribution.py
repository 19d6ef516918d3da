"""Which slot an error comes from: truth is put in place of one slot after the other, and the error is asked again.

What goes when the source's depth is true is the depth's share; and so on along the route. The target's view gets its
truth twice, first only where the source could see: what goes with the rest was never felt by the source, and no method
that knows only the touch can give it back.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Mask, freeze
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.engine.graph import Graph, StageResult
from pipeline.metrics.stage_metrics import METRICS
from pipeline.translation.translate import Translation
from pipeline.values.results import TargetDepth

DEFAULT_METRIC = "touch_depth.contact_mae_mm"  # how far off the target's membrane is where the object really touches it
OUTSIDE_VIEW = "not felt by the source"
_SEEN_TITLE = "carried over"


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorShare:
    """The part of an error that goes when one more slot is true; negative where truth alone makes it worse."""

    stage: str
    title: str
    share: float  # in the figure's unit
    remaining: float  # the error that is left with the truth in place so far


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorAttribution:
    """An error of one frame as a sum: `total` = the parts' shares + `rest`."""

    frame: int
    metric: str  # as in a frame's metrics, "slot.name"
    unit: str
    total: float
    shares: tuple[ErrorShare, ...]
    remainder: float  # with the truth in every slot before the figure's own: that one's doing, and the figure's

    @property
    def summary(self) -> str:
        """The error and its largest part in words."""
        told = f"{self.total:.2f} {self.unit}"
        worst = max(self.shares, key=lambda part: part.share, default=None)
        if worst is None or worst.share <= max(0.0, self.remainder):
            return told
        return f"{told}, of it {worst.share:.2f}: {worst.title}"


def attribute_error(
    translation: Translation,
    graph: Graph,
    params: Mapping[str, object],
    frame: int,
    figure: str = DEFAULT_METRIC,
    progress: Progress = SILENT,
) -> ErrorAttribution | None:
    """The parts of a frame's error by `figure`; None where that figure is not known of this frame.

    Raises SettingProblem for a figure that there is not, or for which more is not better or worse.
    """
    slot, _, name = figure.partition(".")
    if name not in METRICS or slot not in translation.stages:
        known = sorted(f"{s}.*" for s in translation.stages)
        raise SettingProblem(f"no figure {figure!r} on this route; a figure is slot.name, as {', '.join(known)}")
    if METRICS[name].better != "lower":
        raise SettingProblem(f"{figure} is no error; choose a figure of which less is better")

    def evaluate_metric(inputs: Mapping[str, object], part: Progress) -> tuple[Mapping[str, StageResult], float | None]:
        results = graph.evaluate([slot], inputs, params, part)
        return results, translation.compute_metrics(results, frame).get(figure)

    inputs = dict(translation.read_inputs(frame))
    truths = translation.read_true_outputs(frame)
    before = translation.stages[: translation.stages.index(slot)]
    each = 1.0 / (2 + len(before))
    results, total = evaluate_metric(inputs, SubProgress(progress, 0.0, each))
    if total is None:
        return None
    steps = tuple(_steps(translation, {name: truths[name] for name in before if name in truths}, results))
    parts: list[ErrorShare] = []
    left = total
    for index, (of, title, value) in enumerate(steps, start=1):
        inputs[of] = value
        _, now = evaluate_metric(inputs, SubProgress(progress, index * each, each, title))
        if now is None:
            break
        parts.append(ErrorShare(stage=of, title=title, share=left - now, remaining=now))
        left = now
    return ErrorAttribution(
        frame=frame, metric=figure, unit=METRICS[name].unit, total=total, shares=tuple(parts), remainder=left
    )


def _steps(
    translation: Translation, truths: Mapping[str, object], results: Mapping[str, StageResult]
) -> Iterator[tuple[str, str, object]]:
    """(slot, title, truth) in running order."""
    for name, value in truths.items():
        made = results[name].output if name in results else None
        if isinstance(value, TargetDepth) and isinstance(made, TargetDepth):
            yield name, _SEEN_TITLE, _cut(value, made.in_view)
            yield name, OUTSIDE_VIEW, value
        else:
            yield name, translation.catalogue.stage(name).title.lower(), value


def _cut(view: TargetDepth, seen: Mask) -> TargetDepth:
    """The true view without what lies beyond what the source could see."""
    contact = view.contact & seen
    return replace(
        view,
        contact=freeze(contact),
        depth_mm=freeze(np.where(contact, view.depth_mm, np.float32(np.nan))),
        indentation_mm=freeze(np.where(contact, view.indentation_mm, np.float32(0.0))),
        in_view=seen,
    )
