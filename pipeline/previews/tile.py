"""One of several pictures that stand side by side, with its words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.previews.preview import Preview


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """One picture with its words; `truth` and `gap` are what may be shown in its place."""

    title: str
    subtitle: str = ""  # figures, under the title
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])  # those of them that another run has too
    preview: Preview | None = None
    truth: Preview | None = None
    difference: Preview | None = None  # the picture less the truth
    problem: str = ""  # over the picture, or in its place
    starts_row: bool = False  # whether it begins a row
    default_mode: str = ""  # what is shown where nothing of its own is asked for, such as the difference
