"""Object meshes: read, checked for their unit, and kept in millimetres."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.arrays import Doubles, Indices


@dataclass(frozen=True, slots=True, kw_only=True)
class Mesh:
    """A triangle mesh in its own (object) frame."""

    vertices_mm: Doubles  # (n, 3)
    triangles: Indices  # (m, 3)
    name: str = ""
