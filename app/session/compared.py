"""What was chosen in *Compare*: a value that a session keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, cast, get_args

CompareTab = Literal["methods", "two", "seeds"]
LAST_SLOT, ALL_SLOTS = "last", ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """The tab in front and what its controls say."""

    tab: CompareTab = "methods"
    order: str = "worst first"
    slot: str = LAST_SLOT  # of two at once, or all of them
    seeds: int = 8

    @property
    def plain(self) -> dict[str, object]:
        """As a session file keeps it."""
        return asdict(self)


def from_plain(data: object) -> Compared:
    """Of what a session file holds, the usual one where it holds none; raises ValueError that says what is wrong."""
    if data is None:
        return Compared()
    said = cast("Mapping[str, Any]", data) if isinstance(data, dict) else {"": data}
    usual = {field.name: field.default for field in fields(Compared)}
    for name, value in said.items():
        if name not in usual or type(value) is not type(usual[name]):
            raise ValueError(f"{name!r} cannot be {value!r}")
    if said.get("tab", "methods") not in get_args(CompareTab):
        raise ValueError(f"there is no tab {said['tab']!r}")
    return Compared(**said)
