"""The rest surface of a sensor that is described by a mesh.

[rest]
kind = "mesh"
file = "membrane.stl"  # relative to the description
unit = "mm"            # of the file: mm, cm, m or in
step = 0.5             # mm, lattice step; optional
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from pipeline.base.errors import CalibrationError
from pipeline.base.files import read_bytes
from pipeline.base.memo import Memo
from pipeline.base.units import UNIT_MM
from pipeline.engine.digests import compute_digest
from pipeline.geometry.membrane import Membrane

_DEFAULT_STEP_MM, _MIN_STEP_MM, _MAX_STEP_MM = 0.5, 0.01, 10.0  # of the lattice
_membranes: Memo[tuple[Path, str, str, float], Membrane] = Memo(8)


def load_rest_membrane(data: Mapping[str, Any], path: Path) -> Membrane | None:
    """The membrane of `[rest] kind = "mesh"`; None where the section gives numbers.

    Raises CalibrationError for an invalid section, FileProblem or MeshProblem for its file.
    """
    section: Any = data.get("rest")
    if not isinstance(section, dict) or "kind" not in section:
        return None
    rest = cast("dict[str, Any]", section)
    if rest["kind"] != "mesh":
        raise CalibrationError(f"rest.kind must be 'mesh' or left out, got {rest['kind']!r}: '{path}'")
    file, unit, step_mm = rest.get("file"), rest.get("unit"), rest.get("step", _DEFAULT_STEP_MM)
    if not isinstance(file, str) or unit not in UNIT_MM:
        raise CalibrationError(f"rest.file must name a mesh and rest.unit its unit, {', '.join(UNIT_MM)}: '{path}'")
    if not isinstance(step_mm, (int, float)) or not _MIN_STEP_MM <= step_mm <= _MAX_STEP_MM:
        raise CalibrationError(
            f"rest.step must lie within {_MIN_STEP_MM:g} and {_MAX_STEP_MM:g} mm, got {step_mm!r}: '{path}'"
        )
    from pipeline.geometry.mesh_membrane import load_membrane

    mesh, step = path.parent / file, float(step_mm)
    key = (mesh, compute_digest(read_bytes(mesh, "the mesh")), str(unit), step)
    return _membranes.get_or_make(key, lambda: load_membrane(mesh, str(unit), step))
