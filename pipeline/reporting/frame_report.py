"""What became of one translated frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.engine.graph import StageResult


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameReport:
    """One frame's stages and figures; `problem` is the sentence that says why there are none."""

    index: int
    results: Mapping[str, StageResult]
    metrics: Mapping[str, float]
    problem: str = ""
