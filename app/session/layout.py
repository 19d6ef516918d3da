"""Window layout: a value that is part of the session; and the file of the user's named arrangements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args

import msgspec
from msgspec import Meta

from pipeline.base.errors import FileProblem
from pipeline.base.files import read_json, set_aside, write_json
from pipeline.base.typed_data import Name, convert, to_plain

LayoutName = Literal["stages", "inspect", "align", "sweep", "demo", "compare", "track", "task"]
Dims = Literal["2D", "3D", "both"]
DIMS: tuple[Dims, ...] = get_args(Dims)
LAYOUT_NAMES: tuple[LayoutName, ...] = get_args(LayoutName)
# Columns that a layout shows large; all columns of the route where a layout is not listed.
_LARGE_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "align": ("target_depth",), "demo": ("source", "touch"), "sweep": (), "compare": (), "track": (),
    "task": ("source", "touch"),
}  # fmt: skip
_Panes = Annotated[tuple[tuple[Name, Dims], ...], Meta(min_length=1, max_length=3)]  # stage and views of each
_Size = Annotated[int, Meta(ge=0, le=100_000)]  # px
ComparisonTabName = Literal["methods", "two", "seeds"]
LAST_STAGE = "last"
DEFAULT_STAGE = "touch_depth"  # of two settings: what both methods of touch have, and can be subtracted


@dataclass(frozen=True, slots=True)
class Arrangement:
    """A named arrangement of the user: the state of everything in the window that can be dragged."""

    name: Annotated[Name, Meta(min_length=1)]
    _: KW_ONLY
    only_stage: Name = ""  # the only stage of the Stages layout, "" = all
    dock_state: Annotated[str, Meta(max_length=100_000)] = ""  # docks and tool bars, see `app.window.dock_state`
    splitter_sizes_px: Mapping[Name, tuple[_Size, ...]] = field(default_factory=dict)  # of splitters that were dragged


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout by name, with the panes of the Inspect layout."""

    name: LayoutName = "stages"
    panes: _Panes = (("depth", "both"), ("touch_depth", "both"))
    arrangement: Arrangement | None = None  # the user's arrangement it was opened from
    skipped_stages: tuple[Name, ...] = ()  # that Stages and Inspect leave out, to save their time

    @property
    def can_skip(self) -> bool:
        """Whether this layout leaves out skipped stages; the others show what they are made for."""
        return self.name in ("stages", "inspect")

    @property
    def skips(self) -> frozenset[str]:
        """Stages that this layout leaves out."""
        return frozenset(self.skipped_stages) if self.can_skip else frozenset()

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


ARRANGEMENTS_FILE = "arrangements.json"


_KIND, _VERSION = "tactoscope arrangements", 1


class _ArrangementFile(msgspec.Struct):
    arrangements: tuple[Layout, ...]


def load_arrangements(path: Path) -> tuple[Layout, ...]:
    """Read the arrangements of the file at `path`; () if there is no file. Raises FileProblem."""
    if not path.exists():
        return ()
    data = read_json(path, "the arrangements")
    version = cast("dict[str, Any]", data).get(_KIND) if isinstance(data, dict) else None
    if version != _VERSION:
        raise FileProblem(
            f"the arrangements have version {version!r}, this program reads {_VERSION}; save them again, the old file "
            "is renamed",
            path,
        )
    layouts = convert(data, _ArrangementFile, "the arrangements", path).arrangements
    if any(layout.arrangement is None for layout in layouts):
        raise FileProblem("an arrangement has no name; save them again", path)
    return layouts


def save_arrangements(path: Path, layouts: Sequence[Layout]) -> None:
    """Write the arrangements; an unreadable old file is renamed first. Raises FileProblem."""
    try:
        load_arrangements(path)
    except FileProblem:
        set_aside(path)
    write_json(path, {_KIND: _VERSION, "arrangements": to_plain(layouts)}, "the arrangements", load_arrangements)


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonSettings:
    """The current tab and its controls."""

    tab: ComparisonTabName = "methods"
    order: Name = "worst first"
    stage: Name = DEFAULT_STAGE  # of two settings, or all stages
    seeds: int = 8
