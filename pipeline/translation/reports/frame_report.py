"""Report of one translated frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pipeline.core.graph import StageResult


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameReport:
    """Stages and metrics of one frame; `problem` is the reason if there are none."""

    index: int
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    problem: str = ""
    is_user_error: bool = True  # whether the user can mend the problem

    @property
    def without_arrays(self) -> FrameReport:
        """Return the report without arrays and functions, small enough to keep thousands of them
        and to send them between processes.
        """
        results = {
            name: replace(r, output=None, method=None, nodes=()) for name, r in self.results.items()
        }
        return replace(self, results=results, metrics=dict(self.metrics))
