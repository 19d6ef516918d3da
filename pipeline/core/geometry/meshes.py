"""Load object meshes, check their unit, and convert them to millimetres."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Indices, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import FileProblem, MeshProblem, SettingProblem
from pipeline.core.files import read_bytes
from pipeline.core.frozen import frozen
from pipeline.core.geometry import urdf
from pipeline.core.params import UNIT_MM

# extents of objects that a fingertip can touch: a screw to a long tool
SMALLEST_MM = 1.0
LARGEST_MM = 400.0
# a contact is larger than anything below, which is mostly in cm, inches or metres
_SMALLEST_CERTAIN_MM = 5.0
_MERGE_MM = 1e-6  # STL repeats each vertex in float32; true neighbours lie micrometres apart
# bytes of a binary STL
_HEADER = 84
_TRIANGLE = 50
_MAX_VERTICES = 1 << 30
_MAX_CORNERS = 5_000  # of a face: ears are searched in a time that grows with the square
_ROUNDING = 1e-9  # of a polygon's area


@frozen
class Mesh:
    """A triangle mesh in the object frame."""

    vertices_mm: Doubles  # (n, 3)
    triangles: Indices  # (m, 3)
    name: str = ""


class UnitProblem(MeshProblem):
    """A mesh whose size is impossible in its unit and possible in the units `fits`."""

    def __init__(self, size: str, fits: tuple[str, ...], path: Path) -> None:
        """Build the sentence from a description of the size."""
        self.size = size
        self.fits = fits
        self.path = path
        super().__init__(f"{size}; try --mesh-unit {' or '.join(fits)}: '{path}'")


def load_mesh(path: Path, unit: str = "auto") -> Mesh:
    """Load an STL, PLY or OBJ file in mm, duplicate vertices merged and triangles without area
    dropped.

    `unit` is the file's: "mm", "cm", "m", "in", or "auto", which takes mm when the largest extent
    then lies within 5 and 400 mm and refuses anything else, since no mesh file states its unit. A
    URDF names the mesh and its scale in metres. Raises FileProblem when the file cannot be read,
    MeshProblem when it is empty, damaged or in a wrong unit.
    """
    given = path = Path(path)
    if unit != "auto" and unit not in UNIT_MM:
        raise SettingProblem(f"unknown mesh unit {unit!r}; there are auto, {', '.join(UNIT_MM)}")
    stretch = np.ones(3)
    if path.suffix.lower() == urdf.SUFFIX:
        path, factors = urdf.read_mesh_place(path)
        stretch = np.array(factors)
        unit = "m" if unit == "auto" else unit
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise FileProblem(
            "meshes are read from STL, PLY and OBJ files, and a URDF, not from "
            f"{path.suffix or 'this'!r}",
            path,
        )
    vertices, triangles = read(read_bytes(path, "the mesh"), path)
    validate_mesh(vertices, triangles, path)
    vertices = vertices * stretch
    if np.prod(stretch) < 0:  # a mirrored mesh is turned inside out
        triangles = triangles[:, ::-1]
    scale = _find_scale(vertices[triangles.ravel()], unit, given)
    return _clean_mesh(vertices * scale, triangles, path)


def validate_mesh(vertices: Doubles, triangles: NDArray[np.integer], path: Path) -> None:
    """Raise MeshProblem unless there are triangles with valid indices and finite vertices."""
    if not triangles.size:
        raise MeshProblem(f"the mesh has no triangles: '{path}'")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise MeshProblem(f"the mesh has triangles with invalid vertex indices: '{path}'")
    if not np.isfinite(vertices).all():
        raise MeshProblem(f"the mesh has vertices that are not finite: '{path}'")


def sample_surface(mesh: Mesh, n: int, seed: int) -> tuple[Doubles, Doubles]:
    """Return (points (n, 3) in mm, unit normals (n, 3)), uniform over the area.

    Equal seeds give equal bytes.
    """
    corners = mesh.vertices_mm[mesh.triangles]  # (m, 3, 3)
    normals = compute_normals(corners)
    doubled = np.linalg.norm(normals, axis=1)
    if not doubled.sum() > 0:
        raise MeshProblem(f"the mesh {mesh.name!r} has no surface to sample")
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(corners), size=n, p=doubled / doubled.sum())
    u, v = rng.random((2, n))
    folded = u + v > 1.0  # the far half of the parallelogram is folded back onto the triangle
    u = np.where(folded, 1.0 - u, u)[:, None]
    v = np.where(folded, 1.0 - v, v)[:, None]
    a, b, c = (corners[chosen, k] for k in range(3))
    return freeze(a + u * (b - a) + v * (c - a)), freeze(normals[chosen] / doubled[chosen, None])


def compute_normals(corners: Doubles) -> Doubles:
    """The normals (m, 3) of triangles (m, 3, 3), twice their area long."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


@derive_once
def make_grid_triangles(rows: int, cols: int) -> Indices:
    """Triangles (n, 3) between the points of an image in row order, two for each four neighbours.

    Front faces are wound toward the camera: OpenGL flips the normals of back faces.
    """
    first = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)[None, :]).ravel()
    upper = np.stack([first, first + cols, first + 1], axis=-1)
    lower = np.stack([first + 1, first + cols, first + cols + 1], axis=-1)
    return freeze(np.concatenate([upper, lower]).astype(np.int32))


def _find_scale(corners: Doubles, unit: str, path: Path) -> float:
    """Return millimetres per unit of the file."""
    extent = float((corners.max(axis=0) - corners.min(axis=0)).max())
    scale = UNIT_MM.get(unit, 1.0)
    if (SMALLEST_MM if unit != "auto" else _SMALLEST_CERTAIN_MM) <= extent * scale <= LARGEST_MM:
        return scale
    fits = tuple(
        u for u in ("m", "cm", "mm", "in") if SMALLEST_MM <= extent * UNIT_MM[u] <= LARGEST_MM
    )
    read_as = "mm" if unit == "auto" else unit
    size = f"the mesh is {extent * scale:.3g} mm large when read in {read_as}"
    if fits:
        raise UnitProblem(size, fits, path)
    raise MeshProblem(f"{size}; scale it to a touchable size of 1 to 400 mm: '{path}'")


def _clean_mesh(vertices: Doubles, triangles: Indices, path: Path) -> Mesh:
    rounded = np.rint(vertices / _MERGE_MM).astype(np.int64)
    _, first, same = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    kept = vertices[first]
    joined = same.reshape(-1)[triangles]
    joined = joined[np.linalg.norm(compute_normals(kept[joined]), axis=1) > 0]
    if not joined.size:
        raise MeshProblem(f"no triangle of the mesh has an area: '{path}'")
    used, renumbered = np.unique(joined, return_inverse=True)
    return Mesh(
        vertices_mm=freeze(kept[used]),
        triangles=freeze(renumbered.reshape(-1, 3).astype(np.int32)),
        name=path.stem,
    )


def _read_stl(data: bytes, path: Path) -> tuple[Doubles, Indices]:
    """Return the corners of a binary or text STL; each triangle has its own three."""
    n = int.from_bytes(data[80:_HEADER], "little") if len(data) >= _HEADER else 0
    # Some binary files begin with "solid" as text ones do, so the size decides.
    if len(data) == _HEADER + n * _TRIANGLE and len(data) >= _HEADER:
        facets = np.frombuffer(data, np.uint8, offset=_HEADER).reshape(n, _TRIANGLE)
        # after the normal, before the colour
        corners = np.ascontiguousarray(facets[:, 12:48]).view("<f4")
        vertices = corners.reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid":
        vertices = _read_text_stl(data, path)
    else:
        raise FileProblem(
            f"the STL file is cut short or damaged: {n} triangles do not make {len(data)} bytes",
            path,
        )
    return vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)


def _read_text_stl(data: bytes, path: Path) -> Doubles:
    lines = _split_lines(data)
    try:
        vertices = np.array(
            [[float(v) for v in w[1:4]] for w in lines if w[:1] == ["vertex"]], dtype=np.float64
        )
    except ValueError as error:
        raise FileProblem("the text STL has a vertex that is not three numbers", path) from error
    ended = any(w[:1] == ["endsolid"] for w in lines)
    if not ended or len(vertices) % 3 or (len(vertices) and vertices.shape[1:] != (3,)):
        raise FileProblem("the text STL is cut short: a facet or the end is missing", path)
    return vertices.reshape(-1, 3)


def _read_obj(data: bytes, path: Path) -> tuple[Doubles, Indices]:
    """Return vertices and faces of an OBJ, larger faces cut into triangles."""
    vertices: list[list[float]] = []
    triangles: list[tuple[int, ...]] = []
    # (line, corners), which may come before their vertices
    larger: list[tuple[int, list[int]]] = []
    for number, words in enumerate(
        _split_lines(data.replace(b"\\\n", b" ").replace(b"\\\r\n", b" ")), start=1
    ):
        try:
            if words[:1] == ["v"]:
                x, y, z = map(float, words[1:4])  # a weight or a colour may follow
                vertices.append([x, y, z])
            elif words[:1] == ["f"]:
                # 3, 3/1, 3//2 or 3/1/2
                corners = [_parse_vertex_index(word, len(vertices)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face of fewer than three corners")
                if len(corners) == 3:
                    triangles.append(tuple(corners))
                else:
                    larger.append((number, corners))
        except (ValueError, OverflowError) as error:
            raise FileProblem(
                f"line {number} of the OBJ file is no vertex and no face ({error})", path
            ) from error
    points = np.array(vertices, np.float64).reshape(-1, 3)
    for number, corners in larger:
        if max(corners) >= len(points):
            raise MeshProblem(f"the mesh has triangles with invalid vertex indices: '{path}'")
        try:
            triangles += [
                tuple(corners[k] for k in cut) for cut in triangulate_polygon(points[corners])
            ]
        except ValueError as error:
            raise FileProblem(
                f"line {number} of the OBJ file has {error}; export triangles", path
            ) from error
    return points, np.array(triangles, np.int32).reshape(-1, 3)


def triangulate_polygon(points: Doubles) -> list[tuple[int, int, int]]:
    """Triangles (corner numbers) that cover a planar polygon (n, 3), turned as it is: ear by ear
    (Meisters 1975), which makes a fan of a convex one.

    Corners on a line give triangles without an area. Raises ValueError for a polygon that crosses
    itself or has more than `_MAX_CORNERS` corners.
    """
    if len(points) > _MAX_CORNERS:
        raise ValueError(f"a face of more than {_MAX_CORNERS} corners")
    centred = points - points.mean(axis=0)
    # twice the area, by Newell's method
    normal = np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)
    doubled_area = float(np.linalg.norm(normal))
    if not doubled_area > 0.0:  # without an area, however it is cut; or not finite
        return [(0, k, k + 1) for k in range(1, len(points) - 1)]
    drop = int(np.abs(normal).argmax())  # the coordinate along which the polygon is seen
    flat = np.delete(points, drop, axis=1)[:, :: (-1 if drop == 1 else 1)] * (
        1.0,
        np.sign(normal[drop]),
    )
    scale = doubled_area / abs(float(normal[drop]))
    left = list(range(len(points)))
    triangles = list[tuple[int, int, int]]()
    covered = 0.0
    at = 1
    n_tried = 0
    while len(left) > 2:
        at %= len(left)
        ear = (left[at - 1], left[at], left[(at + 1) % len(left)])
        turn = scale * float(_cross(*flat[list(ear)]))
        others = flat[[k for k in left if k not in ear]]
        is_flat = abs(turn) <= _ROUNDING * doubled_area
        if is_flat or (turn > 0.0 and not _holds_any(flat[list(ear)], others)):
            triangles.append(ear)
            covered += abs(turn)
            del left[at]
            n_tried = 0
        else:
            at += 1
            n_tried += 1
        if n_tried > len(left):
            raise ValueError("a face that crosses itself")
    if abs(covered - doubled_area) > 1e-6 * doubled_area:
        raise ValueError("a face that crosses itself")
    return triangles


def _holds_any(triangle: Doubles, points: Doubles) -> bool:
    """Whether points other than its corners lie in a counter-clockwise triangle (3, 2) or on its
    sides.
    """
    points = points[~(points[:, None] == triangle[None]).all(axis=2).any(axis=1)]
    sides = [_cross(triangle[k], triangle[k - 2], points) for k in range(3)]
    return bool((np.minimum.reduce(sides) >= 0.0).any())


def _cross(a: Doubles, b: Doubles, c: Doubles) -> Doubles:
    """Twice the signed area of triangles a, b, c of points (..., 2)."""
    u = b - a
    v = c - a
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def _parse_vertex_index(word: str, n_vertices: int) -> int:
    """Return a face's vertex index: counted from 1, or back from the latest when negative."""
    index = int(word.partition("/")[0])
    if not (0 < index <= _MAX_VERTICES or -n_vertices <= index < 0):
        raise ValueError(f"there is no vertex {index}")
    return index - 1 if index > 0 else n_vertices + index


def _split_lines(data: bytes) -> list[list[str]]:
    return [line.split() for line in data.decode("ascii", errors="replace").splitlines()]


def _read_ply(_data: bytes, path: Path) -> tuple[Doubles, Indices]:
    import open3d as o3d

    library: Any = o3d
    try:
        with library.utility.VerbosityContextManager(library.utility.VerbosityLevel.Error):
            mesh = library.io.read_triangle_mesh(str(path))
    except (UnicodeError, MemoryError) as error:
        raise FileProblem(
            "the PLY file cannot be read; its name must be UTF-8 and its size a mesh's", path
        ) from error
    vertices: NDArray[Any] = np.array(mesh.vertices, dtype=np.float64)
    triangles: NDArray[Any] = np.array(mesh.triangles, dtype=np.int32)
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3)


_READERS: Mapping[str, Callable[[bytes, Path], tuple[Doubles, Indices]]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply,
}
