"""Length units of mesh files, which do not state theirs."""

from collections.abc import Mapping
from typing import Literal

MeshUnit = Literal["auto", "mm", "cm", "m", "in", "inch"]

UNIT_MM: Mapping[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4}
"""Millimetres per unit."""
