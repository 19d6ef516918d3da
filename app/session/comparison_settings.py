"""Settings of *Compare*, stored in the session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, cast, get_args

ComparisonTabName = Literal["methods", "two", "seeds"]
LAST_STAGE, ALL_STAGES = "last", ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonSettings:
    """The current tab and its controls."""

    tab: ComparisonTabName = "methods"
    order: str = "worst first"
    stage: str = LAST_STAGE  # of two settings, or all stages
    seeds: int = 8

    @property
    def plain(self) -> dict[str, object]:
        """Return the settings for a session file."""
        return asdict(self)


def from_plain(data: object) -> ComparisonSettings:
    """Return the settings of a session file, defaults where it has none; raises ValueError that says what is wrong."""
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
