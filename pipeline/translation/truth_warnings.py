"""Doubts that no method can have by itself: those that only the truth of a frame tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.stage_warnings import StageWarning
from pipeline.engine.graph import StageResult
from pipeline.stages.stage import GroundTruth
from pipeline.values.results import TargetDepth

_MOST_SEEN = 0.9  # of the target's contact: what is missing then lies along its rim


def add_truth_warnings(result: StageResult, facts: GroundTruth) -> StageResult:
    """The same result; a target's view also says so where the source saw only a part of what the target felt."""
    view, truth = result.output, facts.target_truth
    if not isinstance(view, TargetDepth) or truth is None or truth.contact is None:
        return result
    n_felt = int(np.count_nonzero(truth.contact))
    if truth.contact.shape != view.in_view.shape or not n_felt:
        return result
    share = np.count_nonzero(truth.contact & view.in_view) / n_felt
    if share >= _MOST_SEEN:
        return result
    told = StageWarning(f"the source saw {share:.0%} of the target's contact: what lies beyond is not carried over")
    return replace(result, notes=(told, *result.notes))
