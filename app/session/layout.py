"""Window layout: a value that is part of the session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

from msgspec import Meta

from pipeline.core.typed_data import Name

LayoutName = Literal["stages", "inspect", "align", "demo", "compare", "track", "task"]
Dims = Literal["2D", "3D", "both"]
DIMS: tuple[Dims, ...] = get_args(Dims)
LAYOUT_NAMES: tuple[LayoutName, ...] = get_args(LayoutName)
# Columns that a layout shows large; all columns of the route where a layout is not listed.
_LARGE_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "align": ("target_depth",),
    "demo": ("source", "touch"),
    "compare": (),
    "track": (),
    "task": ("source", "touch"),
}
# stage and views of each
_Panes = Annotated[tuple[tuple[Name, Dims], ...], Meta(min_length=1, max_length=3)]
ComparisonTabName = Literal["methods", "two", "grid"]
LAST_STAGE = "last"
# of two settings: what both methods of touch have, and can be subtracted
DEFAULT_STAGE = "touch_depth"


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout by name, with the panes of the Inspect layout."""

    name: LayoutName = "stages"
    panes: _Panes = (("depth", "both"), ("touch_depth", "both"))

    def resolve_panes(self, available: Sequence[str]) -> tuple[tuple[str, Dims], ...]:
        """Return the panes with every stage that is not in `available` replaced by a spare one."""
        spare = [name for name in available if name not in dict(self.panes)]
        panes: list[tuple[str, Dims]] = []
        for name, dims in self.panes:
            if name in available or spare:
                panes.append((name if name in available else spare.pop(0), dims))
        return tuple(panes)

    def list_columns(self, available: Sequence[str], only_stage: str = "") -> list[str]:
        """List the columns that the layout shows large (all layouts but Inspect)."""
        shown = [name for name in _LARGE_COLUMNS.get(self.name, available) if name in available]
        return [only_stage] if self.name == "stages" and only_stage in available else shown

    def with_stage(self, pane: int, stage: str) -> Layout:
        """Copy with another stage in a pane; if it is in another pane, the two change places."""
        if not 0 <= pane < len(self.panes):
            return self
        panes = list(self.panes)
        other = next((i for i, (name, _) in enumerate(panes) if name == stage), pane)
        panes[other] = (panes[pane][0], panes[other][1])
        panes[pane] = (stage, panes[pane][1])
        return replace(self, panes=tuple(panes))

    def with_dims(self, pane: int, dims: Dims) -> Layout:
        """Copy with a pane that shows 2D, 3D or both."""
        if not 0 <= pane < len(self.panes):
            return self
        panes = list(self.panes)
        panes[pane] = (panes[pane][0], dims)
        return replace(self, panes=tuple(panes))

    def with_count(self, count: int, available: Sequence[str]) -> Layout:
        """Copy with `count` panes; new panes show the last available stages."""
        panes = list(self.panes[:count])
        spare = [name for name in reversed(available) if name not in dict(panes)]
        while len(panes) < count and spare:
            panes.append((spare.pop(0), "both"))
        return replace(self, panes=tuple(panes))


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonSettings:
    """The current tab and its controls."""

    tab: ComparisonTabName = "methods"
    order: Name = "worst first"
    stage: Name = DEFAULT_STAGE  # of two settings, or all stages
