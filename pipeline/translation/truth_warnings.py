"""Warnings that need ground truth."""

from dataclasses import replace

import numpy as np

from pipeline.base.stage_warnings import StageWarning
from pipeline.engine.graph import StageResult
from pipeline.stages.stage import GroundTruth
from pipeline.values.results import TargetDepth

_MAX_VISIBLE_SHARE = 0.9  # of the target's contact; above this only its rim is missing


def add_truth_warnings(result: StageResult, facts: GroundTruth) -> StageResult:
    """The result, with a warning on a target depth of which only a part is visible to the source."""
    target_depth, truth = result.output, facts.target_truth
    if not isinstance(target_depth, TargetDepth) or truth is None or truth.contact is None:
        return result
    n_contact = int(np.count_nonzero(truth.contact))
    if truth.contact.shape != target_depth.in_view.shape or not n_contact:
        return result
    share = np.count_nonzero(truth.contact & target_depth.in_view) / n_contact
    if share >= _MAX_VISIBLE_SHARE:
        return result
    warning = StageWarning(f"the source saw {share:.0%} of the target's contact: the rest is missing")
    return replace(result, notes=(warning, *result.notes))
