"""Tile of a comparison: a preview with its text."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.views.preview import Preview


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """One preview with its text, truth and difference."""

    title: str
    subtitle: str = ""  # metrics, under the title
    # metrics that another run has too
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])
    preview: Preview | None = None
    truth: Preview | None = None
    difference: Preview | None = None  # the preview minus the truth
    problem: str = ""  # shown over the preview, or in its place
    starts_row: bool = False  # whether it begins a row
    default_mode: str = ""  # comparison mode while none is chosen
