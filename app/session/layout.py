"""Window layout: a value that is part of the session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Literal, cast, get_args

LayoutName = Literal["stages", "inspect", "align", "sweep", "demo", "compare"]
Dims = Literal["2D", "3D", "both"]
DIMS: tuple[Dims, ...] = get_args(Dims)
LAYOUT_NAMES: tuple[LayoutName, ...] = get_args(LayoutName)
# Columns that a layout shows large; all columns of the route where a layout is not listed.
_LARGE_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "align": ("target_depth",), "demo": ("source", "touch"), "sweep": (), "compare": (),
}  # fmt: skip
_MAX_PANES = 3


@dataclass(frozen=True, slots=True)
class Arrangement:
    """A named arrangement of the user: the state of everything in the window that can be dragged."""

    name: str
    _: KW_ONLY
    only_stage: str = ""  # the only stage of the Stages layout, "" = all
    dock_state: str = ""  # docks and tool bars: QMainWindow.saveState in base64
    splitter_sizes_px: Mapping[str, tuple[int, ...]] = field(default_factory=dict)  # of splitters that were dragged


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout by name, with the panes of the Inspect layout."""

    name: LayoutName = "stages"
    panes: tuple[tuple[str, Dims], ...] = (("depth", "both"), ("touch_depth", "both"))  # stage and views
    arrangement: Arrangement | None = None  # the user's arrangement it was opened from

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

    @property
    def plain(self) -> dict[str, object]:
        """JSON form for the session file."""
        data: dict[str, object] = {"name": self.name, "panes": [list(pane) for pane in self.panes]}
        one = self.arrangement
        if one is not None:
            sizes_px = {key: list(sizes) for key, sizes in one.splitter_sizes_px.items()}
            data["arrangement"] = {
                "name": one.name, "only_stage": one.only_stage, "dock_state": one.dock_state,
                "splitter_sizes_px": sizes_px,
            }  # fmt: skip
        return data


def from_plain(data: object) -> Layout:
    """Parse the JSON form; None gives the default layout. Raises ValueError that names the wrong key."""
    if data is None:
        return Layout()
    table = cast("Mapping[str, Any]", data) if isinstance(data, dict) else {}
    name, panes = table.get("name"), table.get("panes")
    if name not in LAYOUT_NAMES:
        raise ValueError(f"name must be one of {', '.join(LAYOUT_NAMES)}, got {name!r}")
    pairs = cast("list[Any]", panes) if isinstance(panes, list) else []
    for pair in pairs:
        if not (isinstance(pair, list) and len(cast("list[Any]", pair)) == 2 and pair[1] in DIMS):
            raise ValueError(f"panes must be pairs of a stage and 2D, 3D or both, got {pair!r}")
    if not 1 <= len(pairs) <= _MAX_PANES:
        raise ValueError(f"there must be one to {_MAX_PANES} panes, got {len(pairs)}")
    return Layout(
        name=name,
        panes=tuple((str(stage), dims) for stage, dims in pairs),
        arrangement=_parse_arrangement(table.get("arrangement")),
    )


def _parse_arrangement(data: object) -> Arrangement | None:
    if data is None:
        return None
    table = cast("Mapping[str, Any]", data) if isinstance(data, dict) else {}
    texts = {key: table.get(key, "") for key in ("name", "only_stage", "dock_state")}
    if not texts["name"] or not all(isinstance(text, str) for text in texts.values()):
        raise ValueError(f"an arrangement needs a name, and texts for only_stage and dock_state, got {data!r}")
    sizes_px = table.get("splitter_sizes_px", {})
    if not isinstance(sizes_px, dict):
        raise ValueError(f"splitter_sizes_px must map splitters to whole numbers of pixels, got {sizes_px!r}")
    parsed = {str(key): _parse_sizes(sizes) for key, sizes in cast("Mapping[Any, Any]", sizes_px).items()}
    return Arrangement(**texts, splitter_sizes_px=parsed)


def _parse_sizes(data: object) -> tuple[int, ...]:
    sizes: list[Any] = cast("list[Any]", data) if isinstance(data, list) else [None]
    if not all(type(size) is int for size in sizes):
        raise ValueError(f"splitter_sizes_px must map splitters to whole numbers of pixels, got {data!r}")
    return tuple(sizes)
