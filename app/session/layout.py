"""Window layout: a value that is part of the session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Literal, get_args

from msgspec import Meta

from pipeline.core.frozen import frozen
from pipeline.core.typed_data import Name

LayoutName = Literal["look", "compare", "align", "track", "task", "folder"]
Dims = Literal["2D", "3D", "both", "scene"]  # scene: both sensors, in one pane at most
DIMS: tuple[Dims, ...] = get_args(Dims)
LAYOUT_NAMES: tuple[LayoutName, ...] = get_args(LayoutName)
# Stages that a layout shows; those of the route where a layout is not listed.
_STAGES: Mapping[str, tuple[str, ...]] = {
    "align": ("target_depth",),
    "compare": (),
    "track": (),
    "task": ("source", "touch"),
    "folder": (),
}
MAX_PANES = 3
# stage and views of each
_Panes = Annotated[tuple[tuple[Name, Dims], ...], Meta(min_length=1, max_length=3)]
ComparisonTabName = Literal["methods", "two", "grid"]
LAST_STAGE = "last"
# of two settings: what both methods of touch have, and can be subtracted
DEFAULT_STAGE = "touch_depth"


@frozen
class Layout:
    """Layout by name, with the panes of *Look*."""

    name: LayoutName = "look"
    panes: _Panes = (("source", "both"), ("touch_depth", "scene"), ("touch", "both"))

    def resolve_panes(self, available: Sequence[str]) -> tuple[tuple[str, Dims], ...]:
        """Return the panes with every stage that is not in `available` replaced by a spare one."""
        if self.name == "align":
            return tuple((name, "both") for name in self.list_stages(available))
        spare = [name for name in available if name not in dict(self.panes)]
        panes: list[tuple[str, Dims]] = []
        for name, dims in self.panes:
            if name in available or spare:
                # one widget: a file may name two
                is_second = dims == "scene" and dims in dict(panes).values()
                shown = name if name in available else spare.pop(0)
                panes.append((shown, "3D" if is_second else dims))
        return tuple(panes)

    def list_stages(self, available: Sequence[str]) -> list[str]:
        """List the stages that the layout shows, large or as cards."""
        return [name for name in _STAGES.get(self.name, available) if name in available]

    def with_stage(self, pane: int, stage: str, dims: Dims = "both") -> Layout:
        """Copy with another stage in a pane; unchanged if a pane shows it.

        The pane that has the scene in place of the stage shows the stage.
        """
        if self.panes[pane : pane + 1] == ((stage, "scene"),):
            return self.with_dims(pane, dims)
        if not 0 <= pane < len(self.panes) or stage in dict(self.panes):
            return self
        panes = list(self.panes)
        panes[pane] = (stage, dims)
        return replace(self, panes=tuple(panes))

    def with_dims(self, pane: int, dims: Dims) -> Layout:
        """Copy with a pane that shows 2D, 3D or both."""
        if not 0 <= pane < len(self.panes):
            return self
        panes = [(name, "3D" if old == dims == "scene" else old) for name, old in self.panes]
        panes[pane] = (panes[pane][0], dims)
        return replace(self, panes=tuple(panes))

    def with_toggled(self, stage: str) -> Layout:
        """Copy with one more pane for a stage, in place of the last of three; or without it."""
        others = tuple(pane for pane in self.panes if pane[0] != stage)
        if len(others) < len(self.panes):
            return replace(self, panes=others or self.panes)
        return replace(self, panes=(*self.panes[: MAX_PANES - 1], (stage, "both")))


@frozen
class ComparisonSettings:
    """The current tab and its controls."""

    tab: ComparisonTabName = "methods"
    order: Name = "worst first"
    stage: Name = DEFAULT_STAGE  # of two settings, or all stages
