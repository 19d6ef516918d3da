"""How the window is arranged: a value that a session keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Literal, cast, get_args

LayoutName = Literal["stages", "inspect", "align", "sweep", "demo", "compare"]
Dims = Literal["2D", "3D", "both"]
DIMS: tuple[Dims, ...] = get_args(Dims)
LAYOUT_NAMES: tuple[LayoutName, ...] = get_args(LayoutName)
_ALIGNED, _DEMONSTRATED = ("target_depth",), ("source", "touch")
_MOST_PANES = 3


@dataclass(frozen=True, slots=True)
class Arrangement:
    """What a user's arrangement has besides: whatever can be dragged, as the window tells it."""

    name: str
    _: KW_ONLY
    only_stage: str = ""  # the only slot of *Stages*, "" = all
    dock_state: str = ""  # drawers and tool bars, Qt's state in base64
    splitter_sizes_px: Mapping[str, tuple[int, ...]] = field(
        default_factory=dict
    )  # handles that were dragged -> sizes in pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Which arrangement, and what stands in the panes of *Inspect*."""

    name: LayoutName = "stages"
    panes: tuple[tuple[str, Dims], ...] = (("depth", "both"), ("touch_depth", "both"))  # slot and what is shown of it
    arrangement: Arrangement | None = None  # the user's arrangement that it began as

    def resolve_panes(self, here: Sequence[str]) -> tuple[tuple[str, Dims], ...]:
        """The panes where only these slots are here: others take the place of those that are not."""
        spare = [name for name in here if name not in dict(self.panes)]
        found: list[tuple[str, Dims]] = []
        for name, dims in self.panes:
            if name in here or spare:
                found.append((name if name in here else spare.pop(0), dims))
        return tuple(found)

    def list_columns(self, here: Sequence[str], alone: str = "") -> list[str]:
        """The columns in large of those that are here, outside *Inspect*."""
        wanted: Mapping[str, Sequence[str]] = {"align": _ALIGNED, "demo": _DEMONSTRATED, "sweep": (), "compare": ()}
        found = [name for name in wanted.get(self.name, here) if name in here]
        return [alone] if self.name == "stages" and alone in here else found

    def with_stage(self, pane: int, stage: str) -> Layout:
        """The same with another slot in a pane; one that stands in another pane changes places with it."""
        if not 0 <= pane < len(self.panes):
            return self
        panes = list(self.panes)
        other = next((i for i, (name, _) in enumerate(panes) if name == stage), pane)
        panes[other] = (panes[pane][0], panes[other][1])
        panes[pane] = (stage, panes[pane][1])
        return replace(self, panes=tuple(panes))

    def with_dims(self, pane: int, dims: Dims) -> Layout:
        """The same with a pane that shows 2D, 3D or both."""
        if not 0 <= pane < len(self.panes):
            return self
        panes = list(self.panes)
        panes[pane] = (panes[pane][0], dims)
        return replace(self, panes=tuple(panes))

    def with_count(self, count: int, here: Sequence[str]) -> Layout:
        """The same with so many panes, filled up from the last slots that are here."""
        panes = list(self.panes[:count])
        spare = [name for name in reversed(here) if name not in dict(panes)]
        while len(panes) < count and spare:
            panes.append((spare.pop(0), "both"))
        return replace(self, panes=tuple(panes))

    @property
    def plain(self) -> dict[str, object]:
        """As a session file keeps it."""
        data: dict[str, object] = {"name": self.name, "panes": [list(pane) for pane in self.panes]}
        own = self.arrangement
        if own is not None:
            splits = {key: list(sizes) for key, sizes in own.splitter_sizes_px.items()}
            data["arrangement"] = {"name": own.name, "only_stage": own.only_stage, "dock_state": own.dock_state, "splitter_sizes_px": splits}
        return data


def from_plain(data: object) -> Layout:
    """Of what a session file holds, the usual one where it holds none; raises ValueError that says what is wrong."""
    if data is None:
        return Layout()
    table = cast("Mapping[str, Any]", data) if isinstance(data, dict) else {}
    name, panes = table.get("name"), table.get("panes")
    if name not in LAYOUT_NAMES:
        raise ValueError(f"name must be one of {', '.join(LAYOUT_NAMES)}, got {name!r}")
    pairs = cast("list[Any]", panes) if isinstance(panes, list) else []
    for pair in pairs:
        if not (isinstance(pair, list) and len(cast("list[Any]", pair)) == 2 and pair[1] in DIMS):
            raise ValueError(f"panes must be pairs of a slot and 2D, 3D or both, got {pair!r}")
    if not 1 <= len(pairs) <= _MOST_PANES:
        raise ValueError(f"there must be one to {_MOST_PANES} panes, got {len(pairs)}")
    return Layout(name=name, panes=tuple((str(slot), dims) for slot, dims in pairs), arrangement=_own(table.get("arrangement")))


def _own(data: object) -> Arrangement | None:
    if data is None:
        return None
    table = cast("Mapping[str, Any]", data) if isinstance(data, dict) else {}
    words = {key: table.get(key, "") for key in ("name", "only_stage", "dock_state")}
    if not words["name"] or not all(isinstance(word, str) for word in words.values()):
        raise ValueError(f"an arrangement of one's own needs a name, and texts for alone and docks, got {data!r}")
    splits = table.get("splitter_sizes_px", {})
    if not isinstance(splits, dict):
        raise ValueError(f"splits must map handles to whole numbers of pixels, got {splits!r}")
    known = {str(key): _sizes(sizes) for key, sizes in cast("Mapping[Any, Any]", splits).items()}
    return Arrangement(**words, splitter_sizes_px=known)


def _sizes(data: object) -> tuple[int, ...]:
    sizes: list[Any] = cast("list[Any]", data) if isinstance(data, list) else [None]
    if not all(type(size) is int for size in sizes):
        raise ValueError(f"splits must map handles to whole numbers of pixels, got {data!r}")
    return tuple(sizes)
