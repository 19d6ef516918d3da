"""What is known of one frame, for the frames table and the timeline."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace

from pipeline.core.arrays import Image
from pipeline.core.frozen import frozen

THUMBNAIL_PX = 60, 42  # largest width and height
# that every summary has
FRAME_FIGURES = ("frame.n_warnings", "frame.contact_area_mm2", "frame.max_indentation_mm")


@frozen
class FrameSummary:
    """Summary of one frame."""

    max_indentation_mm: float = 0.0
    contact_area_mm2: float = 0.0
    # "stage.metric" -> value
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])
    problem: str = ""  # why the frame has no result
    warnings: tuple[str, ...] = ()  # "stage: sentence"
    cause: str = ""  # stage that most of the error comes from
    thumbnail: Image | None = None  # (rows, cols, 3) of the source
    # the same in the dark theme's colours; None = no other colours
    dark_thumbnail: Image | None = None
    is_complete: bool = False  # whether it has the metrics that take another translation

    def get_metric(self, name: str) -> float:
        """Return a metric of a frame with contact; NaN if unknown."""
        if self.problem or self.contact_area_mm2 <= 0:
            return math.nan
        own = {
            "frame.contact_area_mm2": self.contact_area_mm2,
            "frame.max_indentation_mm": self.max_indentation_mm,
        }
        return own.get(name, self.metrics.get(name, math.nan))

    def merge(self, newer: FrameSummary) -> FrameSummary:
        """Return the newer summary of the same frame and settings, with what only this one
        knows.
        """
        if newer.problem:
            return newer
        return replace(
            newer,
            metrics={**self.metrics, **newer.metrics},
            cause=newer.cause or self.cause,
            thumbnail=self.thumbnail if newer.thumbnail is None else newer.thumbnail,
            dark_thumbnail=self.dark_thumbnail if newer.thumbnail is None else newer.dark_thumbnail,
            is_complete=newer.is_complete or self.is_complete,
        )
