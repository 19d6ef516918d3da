"""How two sensors that feel the same touch stand to each other: stated, kept in files, judged and refined."""

from pipeline.alignment.transforms import Alignment, between

__all__ = ["Alignment", "between"]
