"""What became of one translated frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.engine.graph import StageResult, State


@dataclass(frozen=True, slots=True, kw_only=True)
class StageLine:
    """What the report says of one stage."""

    name: str
    ms: float
    state: State
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLines:
    """What the report says of one frame: small, so that thousands of frames may be listed."""

    index: int
    stages: tuple[StageLine, ...]
    metrics: Mapping[str, float]
    problem: str = ""  # the sentence that says why there are no stages
    foreseen: bool = True  # whether that is one of our own sentences about what the user can mend


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameReport:
    """One frame's stages with all their arrays, and its figures."""

    index: int
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]

    @property
    def lines(self) -> FrameLines:
        """What is left to say of the frame once its arrays are on disk."""
        stages = tuple(
            StageLine(name=r.name, ms=round(r.ms, 3), state=r.state, notes=r.notes) for r in self.results.values()
        )
        return FrameLines(index=self.index, stages=stages, metrics=dict(self.metrics))
