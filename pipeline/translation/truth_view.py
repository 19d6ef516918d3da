"""Ground truth of a stage, and the difference to it, as a column shows them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from pipeline.core.errors import StageWarning
from pipeline.core.frozen import frozen
from pipeline.core.graph import StageResult
from pipeline.core.values.results import DepthMap, TargetDepth
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.stage import GroundTruth
from pipeline.views.difference import compute_difference
from pipeline.views.display_params import DisplayParams
from pipeline.views.layers import Layer
from pipeline.views.preview import Preview, make_indentation_preview
from pipeline.views.view import PreviewContext, View

ComparisonMode = Literal["", "truth", "difference", "wipe", "blink"]


@frozen
class TruthView:
    """Preview of a stage's ground truth; no difference if the two cannot be subtracted."""

    truth: Preview
    difference_to_truth: Preview | None
    layers: tuple[Layer, ...] = ()  # of the ground truth


def build_observation_view(
    preview: Preview, observed: DepthMap, target: SensorSpec, display: DisplayParams
) -> TruthView:
    """The target's own measured depth, and the difference of a reprojected preview to it."""
    recorded = make_indentation_preview(observed.indentation_mm, observed, target, display)
    difference = compute_difference(preview, recorded, label="reprojected minus recorded")
    return TruthView(
        truth=replace(recorded, caption=f"recorded by {target.title}"),
        difference_to_truth=difference,
    )


def build_truth_view(
    name: str, view: View, preview: Preview, truths: Mapping[str, Any], context: PreviewContext
) -> TruthView | None:
    """Ground truth of the stage `name`, drawn as its value is.

    None if the recording does not hold it.
    """
    if name not in truths:
        return None
    true_context = replace(context, outputs={**context.outputs, **truths})
    true = view.make_preview(truths[name], true_context)
    return TruthView(
        truth=replace(true, caption=f"truth: {true.caption}"),
        difference_to_truth=compute_difference(preview, true),
        layers=view.make_layers(truths[name], true_context, true),
    )


_MAX_VISIBLE_SHARE = 0.9  # of the target's contact; above this only its rim is missing


def add_truth_warnings(result: StageResult, facts: GroundTruth) -> StageResult:
    """The result, with a warning on a target depth of which only a part is visible to the
    source.
    """
    target_depth = result.output
    truth = facts.target_truth
    if not isinstance(target_depth, TargetDepth) or truth is None or truth.contact is None:
        return result
    n_contact = int(np.count_nonzero(truth.contact))
    if truth.contact.shape != target_depth.in_view.shape or not n_contact:
        return result
    share = np.count_nonzero(truth.contact & target_depth.in_view) / n_contact
    if share >= _MAX_VISIBLE_SHARE:
        return result
    warning = StageWarning(
        f"the source saw {share:.0%} of the target's contact: the rest is missing"
    )
    return replace(result, notes=(warning, *result.notes))
