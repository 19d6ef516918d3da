"""What became of one translated frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pipeline.engine.graph import StageResult


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameReport:
    """One frame's slots and figures; `problem` is the sentence that says why there are none."""

    index: int
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    problem: str = ""
    is_user_error: bool = True  # whether the problem is one that the user can mend

    @property
    def without_arrays(self) -> FrameReport:
        """What is left to say once the arrays are on disk: small, so that thousands of frames may be listed."""
        return replace(self, results={name: replace(r, output=None) for name, r in self.results.items()})
