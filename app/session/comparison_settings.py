"""What was chosen in *Compare*: a value that a session keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, cast, get_args

ComparisonTabName = Literal["methods", "two", "seeds"]
LAST_STAGE, ALL_STAGES = "last", ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonSettings:
    """The tab in front and what its controls say."""

    tab: ComparisonTabName = "methods"
    order: str = "worst first"
    stage: str = LAST_STAGE  # of two at once, or all of them
    seeds: int = 8

    @property
    def plain(self) -> dict[str, object]:
        """As a session file keeps it."""
        return asdict(self)


def from_plain(data: object) -> ComparisonSettings:
    """Of what a session file holds, the usual one where it holds none; raises ValueError that says what is wrong."""
    if data is None:
        return ComparisonSettings()
    said = cast("Mapping[str, Any]", data) if isinstance(data, dict) else {"": data}
    usual = {field.name: field.default for field in fields(ComparisonSettings)}
    for name, value in said.items():
        if name not in usual or type(value) is not type(usual[name]):
            raise ValueError(f"{name!r} cannot be {value!r}")
    if said.get("tab", "methods") not in get_args(ComparisonTabName):
        raise ValueError(f"there is no tab {said['tab']!r}")
    return ComparisonSettings(**said)
