"""The rest surface of a sensor that is described by a mesh.

[rest]
kind = "mesh"
file = "membrane.stl"  # relative to the description
unit = "mm"            # of the file: mm, cm, m or in
step = 0.5             # mm, lattice step; optional
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from pipeline.base.files import read_bytes
from pipeline.base.memo import Memo
from pipeline.base.typed_data import FileName, convert
from pipeline.engine.digests import compute_digest
from pipeline.geometry.membrane import Membrane
from pipeline.sensors.descriptions import DESCRIPTION


class _RestMesh(msgspec.Struct, kw_only=True, frozen=True):
    """[rest] with a mesh."""

    kind: Literal["mesh"]
    file: FileName
    unit: Literal["mm", "cm", "m", "in", "inch"]
    step: Annotated[float, Meta(ge=0.01, le=10.0)] = 0.5  # mm


_membranes: Memo[tuple[Path, str, str, float], Membrane] = Memo(8)


def load_rest_membrane(data: Mapping[str, Any], path: Path) -> Membrane | None:
    """The membrane of `[rest] kind = "mesh"`; None where the section gives numbers.

    Raises FileProblem for an invalid section or file, MeshProblem for the mesh in it.
    """
    section: Any = data.get("rest")
    if not isinstance(section, dict) or "kind" not in section:
        return None
    rest = convert(section, _RestMesh, DESCRIPTION, path, within="rest")
    from pipeline.geometry.mesh_membrane import load_membrane

    mesh = path.parent / rest.file
    key = (mesh, compute_digest(read_bytes(mesh, "the mesh")), rest.unit, rest.step)
    return _membranes.get_or_make(key, lambda: load_membrane(mesh, rest.unit, rest.step))
