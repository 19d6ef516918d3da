"""The mesh that a URDF names, with its scale.

Lengths of a URDF are metres. Its own offsets are not applied.
"""

import math
from pathlib import Path
from xml.etree import ElementTree

from pipeline.core.errors import FileProblem
from pipeline.core.files import read_bytes

SUFFIX = ".urdf"
_MAX_SCALE = 1e6


def read_mesh_place(path: Path) -> tuple[Path, tuple[float, float, float]]:
    """(mesh file, metres per unit along x, y and z) of a URDF with one mesh; raises FileProblem.

    The file lies in the URDF's folder or in that of its package, one above; other places are
    refused.
    """
    content = read_bytes(path, "the URDF")
    if b"<!" in content.replace(b"<!--", b""):
        raise FileProblem("the URDF defines entities, which are not read", path)
    try:
        root = ElementTree.fromstring(content)  # noqa: S314 # without entities, see above
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise FileProblem(f"the URDF is not valid XML ({error})", path) from error
    found = {
        (mesh.get("filename", ""), mesh.get("scale", "1 1 1"))
        for geometry in root.iter("geometry")
        for mesh in geometry.iter("mesh")
    }
    if len(found) != 1:
        names = ", ".join(sorted(name for name, _ in found)) or "boxes, balls and cylinders alone"
        raise FileProblem(
            f"the URDF must name one mesh, it has {names}; give that of the object itself", path
        )
    (name, text) = found.pop()
    try:
        x, y, z = (float(word) for word in text.split())
    except ValueError as error:
        raise FileProblem(
            f"the scale of the URDF's mesh is no three numbers: {text!r}", path
        ) from error
    if not all(math.isfinite(s) and 0 < abs(s) < _MAX_SCALE for s in (x, y, z)):
        raise FileProblem(f"the scale of the URDF's mesh cannot be right: {text!r}", path)
    return _find_file(name, path), (x, y, z)


def _find_file(name: str, path: Path) -> Path:
    home = path.parent.resolve()
    package, _, inside = name.removeprefix("package://").partition("/")
    names = (
        [inside, f"{package}/{inside}"]
        if name.startswith("package://")
        else [name.removeprefix("file://")]
    )
    for folder in (home, home.parent):
        for one in names:
            file = (folder / one).resolve()
            if file.is_file() and file.is_relative_to(home.parent):
                return file
    raise FileProblem(f"the URDF's mesh {name!r} is not in its folder or the one above", path)
