"""The one way that values are declared: frozen, slotted, keyword-only dataclasses."""

from dataclasses import dataclass, field
from typing import TypeVar, dataclass_transform

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def frozen(kind: type[T]) -> type[T]:
    """Make a class a dataclass whose fields are given by name and never change."""
    return dataclass(frozen=True, slots=True, kw_only=True)(kind)
