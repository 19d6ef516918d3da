"""Settings of *Compare*, stored in the session."""

from dataclasses import dataclass
from typing import Literal

from pipeline.base.typed_data import Name

ComparisonTabName = Literal["methods", "two", "seeds"]
LAST_STAGE = "last"
DEFAULT_STAGE = "touch_depth"  # of two settings: what both methods of touch have, and can be subtracted


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonSettings:
    """The current tab and its controls."""

    tab: ComparisonTabName = "methods"
    order: Name = "worst first"
    stage: Name = DEFAULT_STAGE  # of two settings, or all stages
    seeds: int = 8
