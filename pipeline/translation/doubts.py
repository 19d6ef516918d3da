"""Doubts that no method can have by itself: those that only the truth of a frame tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.base.doubts import Doubt
from pipeline.engine.graph import StageResult
from pipeline.stages.slot import Facts
from pipeline.values.results import TargetView

_MOST_SEEN = 0.9  # of the target's contact: what is missing then lies along its rim


def with_truth(result: StageResult, facts: Facts) -> StageResult:
    """The same result; a target's view also says so where the source saw only a part of what the target felt."""
    view, truth = result.output, facts.target
    if not isinstance(view, TargetView) or truth is None or truth.contact is None:
        return result
    n_felt = int(np.count_nonzero(truth.contact))
    if truth.contact.shape != view.known.shape or not n_felt:
        return result
    share = np.count_nonzero(truth.contact & view.known) / n_felt
    if share >= _MOST_SEEN:
        return result
    told = Doubt(f"the source saw {share:.0%} of the target's contact: what lies beyond is not carried over")
    return replace(result, notes=(told, *result.notes))
