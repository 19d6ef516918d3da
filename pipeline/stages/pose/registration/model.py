"""Objects for registration: evenly spread surface points with outward normals, and the distance
grid, cached.
"""

from __future__ import annotations

import math

import numpy as np

from pipeline.core.arrays import Doubles, Mask
from pipeline.core.digests import compute_digest
from pipeline.core.errors import MeshProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry.distance_grid import DistanceGrid, load_distance_grid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.memo import Memo
from pipeline.core.progress import SILENT, Progress

N_MODEL = 30_000  # points on the whole object
_MAX_BYTES = 12 * 1024 * 1024  # of the cache: one or two objects with their grids
_objects: Memo[str, PreparedObject] = Memo(4, most_bytes=_MAX_BYTES)

_FACET_RAD = math.radians(
    20.0
)  # largest angle between facets of a round surface (18 sides); `simulation/shapes` has 48 and more
_VERTEX_DECIMALS = 6  # decimals (mm) to which shared vertices agree, as in a single-precision STL
# steps of the plane's most even additive sequence (R2)
_SEQUENCE_STEPS = (0.7548776662466927, 0.5698402909980532)


@frozen
class ObjectModel:
    """Points on an object's surface, in the object frame."""

    points_mm: Doubles  # (n, 3)
    normals: Doubles  # (n, 3)
    # (n,) rad^2, mean square angle between a facet's normal and the round surface's
    facet_error_sq: Doubles
    area_mm2: float  # area of the surface that the points represent

    def select(self, which: Mask) -> ObjectModel:
        """Return the marked points and their share of the area."""
        share = float(which.mean()) if which.size else 0.0
        return ObjectModel(
            points_mm=self.points_mm[which],
            normals=self.normals[which],
            facet_error_sq=self.facet_error_sq[which],
            area_mm2=self.area_mm2 * share,
        )

    def thin(self, n: int) -> ObjectModel:
        """Return about `n` of the points, evenly taken, for the same area."""
        step = max(1, len(self.points_mm) // n)
        return ObjectModel(
            points_mm=np.ascontiguousarray(self.points_mm[::step]),
            normals=np.ascontiguousarray(self.normals[::step]),
            facet_error_sq=self.facet_error_sq[::step],
            area_mm2=self.area_mm2,
        )


def sample_model(mesh: Mesh, n_points: int, seed: int) -> ObjectModel:
    """Sample `n_points` uniformly by area; raises MeshProblem for a mesh without surface."""
    if (
        len(mesh.vertices_mm) == 0
        or len(mesh.triangles) == 0
        or not np.isfinite(mesh.vertices_mm).all()
    ):
        raise MeshProblem(
            "the object mesh has no triangles, or vertices that are not finite; export it again"
        )
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices_mm):
        raise MeshProblem("the object mesh names vertices that it does not have; export it again")
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    across = np.cross(b - a, c - a)
    twice_area = np.linalg.norm(across, axis=1)
    total = float(twice_area.sum())
    if not total > 0:
        raise MeshProblem("every triangle of the object mesh has zero area; check its unit")
    # Triangles of a closed mesh that are wound inwards enclose a negative volume.
    sign = -1.0 if float(np.einsum("ij,ij->", a - a.mean(axis=0), across)) < 0 else 1.0
    rng = np.random.default_rng(seed)
    rank = (np.arange(n_points) + rng.random()) / n_points * total
    triangle = np.minimum(np.searchsorted(np.cumsum(twice_area), rank), len(twice_area) - 1)
    u, v = ((np.arange(n_points) * step + rng.random()) % 1.0 for step in _SEQUENCE_STEPS)
    fold = u + v > 1.0
    u = np.where(fold, 1.0 - u, u)[:, None]
    v = np.where(fold, 1.0 - v, v)[:, None]
    points = a[triangle] + u * (b - a)[triangle] + v * (c - a)[triangle]
    mixed = rng.permutation(n_points)  # so that every n-th point covers the whole object
    unit = across / np.maximum(twice_area, 1e-300)[:, None]
    return ObjectModel(
        points_mm=points[mixed],
        normals=(sign * unit[triangle])[mixed],
        facet_error_sq=_facet_error_sq(mesh, unit)[triangle[mixed]],
        area_mm2=total / 2.0,
    )


def _facet_error_sq(mesh: Mesh, normals: Doubles) -> Doubles:
    """Return (m,) mean square angle between triangle normals (m, 3) and the round surface they
    approximate.

    Across a facet whose neighbour is rotated by an angle, the true normal rotates by the same
    angle: a twelfth of its square. A larger angle than a facet's is an edge of the object.
    """
    place = np.unique(np.round(mesh.vertices_mm, _VERTEX_DECIMALS), axis=0, return_inverse=True)[
        1
    ].reshape(-1)
    corners = place[mesh.triangles]
    edges = np.sort(
        np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1
    )
    triangle = np.tile(np.arange(len(corners)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    one = triangle[order[:-1]]
    other = triangle[order[1:]]
    shared = (edges[order[:-1]] == edges[order[1:]]).all(axis=1)
    cosine = np.einsum("ij,ij->i", normals[one], normals[other])
    angle = np.where(
        shared & (cosine > math.cos(_FACET_RAD)), np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0
    )
    out = np.zeros(len(corners))
    for side in (one, other):
        np.maximum.at(out, side, angle**2 / 12.0)
    return out


@frozen
class PreparedObject:
    """An object's distance grid and surface points."""

    grid: DistanceGrid
    model: ObjectModel
    middle_mm: Doubles  # (3,) centre of its bounding box


def prepare_object(mesh: Mesh, seed: int, progress: Progress = SILENT) -> PreparedObject:
    """Return the prepared object of a mesh, cached; raises MeshProblem when it has no surface."""
    key = compute_digest(
        (seed, np.asarray(mesh.vertices_mm, np.float64), np.asarray(mesh.triangles, np.int32))
    )

    def make() -> PreparedObject:
        model = sample_model(mesh, N_MODEL, seed)  # first: it raises when there is no surface
        middle_mm = (mesh.vertices_mm.min(axis=0) + mesh.vertices_mm.max(axis=0)).astype(
            np.float64
        ) / 2
        return PreparedObject(
            grid=load_distance_grid(mesh, progress), model=model, middle_mm=middle_mm
        )

    return _objects.get_or_make(key, make)
