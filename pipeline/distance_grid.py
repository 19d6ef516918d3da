"""Signed distance of a mesh on a lattice: a coarse one of the whole neighbourhood, blocks of a fine one at the surface.

Looking a point up takes some 30 ns and is as exact as the fine step allows: on planes to 1e-4 mm, beside an edge to a
third of that step. This is what a registration asks thousands of times where a search tree would be asked for partners.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Doubles, Floats, Indices, freeze
from pipeline.errors import MeshProblem
from pipeline.meshes import Mesh
from pipeline.progress import SILENT, Progress

VERSION = 1  # of what is built; kept grids of another version are built again
OPEN = "the mesh is not closed: inside and outside are told by the sides of its triangles"
_CELLS = 8  # fine cells along a block's edge, as in the kernels
_SMALLEST_MM = 0.8  # coarse step: 0.1 mm at the surface, where a registration is within 1.2 of what is possible
_MOST_CELLS, _MOST_BLOCKS = 600_000, 7_000  # 5 MB and 10 MB
_MARGIN_MM = 3.0  # of lattice around the object
_BAND = 0.25  # of the coarse step, on both sides of the surface, is fine
_OPEN_SHARE = 0.01  # of the lattice's lines may miss a wall before the mesh counts as open
_BATCH = 400_000  # distances between two reports of progress
_SHIFT = (0.00137, 0.00219, 0.00311)  # of a fine step: lines beside the lattice pass the edges of aligned meshes


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceGrid:
    """Distances (mm, negative inside) in the frame of the object; linear between nodes."""

    origin_mm: Doubles  # (3,) of node (0, 0, 0)
    step_mm: float  # of the coarse lattice
    coarse_mm: Floats = field(repr=False)  # (nx, ny, nz)
    block: Indices = field(repr=False)  # (nx - 1, ny - 1, nz - 1) -> number of the cell's fine block; -1 = none
    fine: NDArray[np.int16] = field(repr=False)  # (blocks, 9, 9, 9) in quanta
    quantum_mm: float
    notes: tuple[str, ...] = ()

    @property
    def fine_step_mm(self) -> float:
        """Distance between nodes at the surface."""
        return self.step_mm / _CELLS

    @property
    def lattice(self) -> tuple[Any, ...]:
        """The arguments of the kernels' look-up."""
        flat = (self.coarse_mm.reshape(-1), self.block.reshape(-1), self.fine.reshape(-1))
        return (self.origin_mm, self.step_mm, self.coarse_mm.shape, *flat, self.quantum_mm)

    def at(self, points_mm: Doubles) -> tuple[Doubles, Doubles]:
        """(distances (n,) in mm, gradients (n, 3)) of points (n, 3); NaN where a point is not finite."""
        from pipeline.distance_grid_kernels import look_up_all

        found = look_up_all(np.ascontiguousarray(points_mm, dtype=np.float64), *self.lattice)
        return freeze(found[:, 0].copy()), freeze(found[:, 1:].copy())


def built(mesh: Mesh, progress: Progress = SILENT) -> DistanceGrid:
    """The grid of a mesh, computed anew (a second or two); MeshProblem when it has no surface.

    Overlapping closed bodies count as their union. An open sheet is told apart by the sides of its triangles.
    """
    corners = _corners(mesh)
    origin, step_mm, cells = _lattice(corners)
    surface = _Surface.of(mesh, origin, step_mm, cells)
    nodes = _CELLS * _lattice_nodes((0, 0, 0), tuple(n + 1 for n in cells))
    coarse = surface.signed_mm(nodes, progress, 0.0, 0.2).reshape([n + 1 for n in cells])
    progress.step(0.2, "finding the surface's blocks")
    chosen = surface.near(_lattice_nodes((0, 0, 0), tuple(cells)), coarse)
    offsets = _lattice_nodes((0, 0, 0), (_CELLS + 1,) * 3)
    quantum_mm = step_mm * (math.sqrt(3.0) + _BAND + 0.25) / np.iinfo(np.int16).max
    fine = np.empty((len(chosen), len(offsets)), dtype=np.int16)
    at_once = max(1, _BATCH // len(offsets))
    for k in range(0, len(chosen), at_once):
        part = (_CELLS * chosen[k : k + at_once, None] + offsets[None]).reshape(-1, 3)
        lengths = surface.signed_mm(part, progress, 0.2 + 0.8 * k / len(chosen), 0.8 * at_once / len(chosen))
        fine[k : k + at_once] = np.rint(lengths / quantum_mm).reshape(-1, len(offsets))
    kept = np.abs(fine).min(axis=1) <= _BAND * step_mm / quantum_mm
    block = np.full(cells, -1, dtype=np.int32)
    block[tuple(chosen[kept].T)] = np.arange(int(kept.sum()), dtype=np.int32)
    return DistanceGrid(
        origin_mm=freeze(origin), step_mm=step_mm, coarse_mm=freeze(coarse.astype(np.float32)), block=freeze(block),
        fine=freeze(fine[kept].reshape(-1, *(_CELLS + 1,) * 3)), quantum_mm=quantum_mm, notes=surface.notes,
    )  # fmt: skip


def _corners(mesh: Mesh) -> Doubles:
    vertices = np.asarray(mesh.vertices_mm, dtype=np.float64)
    if len(mesh.triangles) == 0 or not np.isfinite(vertices).all():
        raise MeshProblem("the object mesh has no triangles, or vertices that are not finite; export it again")
    corners = vertices[mesh.triangles]
    if not _area_mm2(corners) > 0:
        raise MeshProblem("every triangle of the object mesh has zero area; check its unit")
    return corners


def _area_mm2(corners: Doubles) -> float:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(across, axis=1).sum()) / 2.0


def _lattice(corners: Doubles) -> tuple[Doubles, float, tuple[int, int, int]]:
    """(origin, coarse step, cells): the smallest step that stays within the memory."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    size = high - low + 2 * _MARGIN_MM
    by_cells = (float(size.prod()) / _MOST_CELLS) ** (1 / 3)
    by_blocks = math.sqrt(2.2 * _area_mm2(corners) / _MOST_BLOCKS)  # a flat piece of a step squared touches about two
    step_mm = max(_SMALLEST_MM, by_cells, by_blocks)
    cells = np.ceil(size / step_mm).astype(int)
    nx, ny, nz = (int(n) for n in cells)
    return (low + high - cells * step_mm) / 2, step_mm, (nx, ny, nz)


def _lattice_nodes(first: tuple[int, ...], shape: tuple[int, ...]) -> NDArray[np.int64]:
    axes = np.meshgrid(*(np.arange(a, a + n) for a, n in zip(first, shape, strict=True)), indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Surface:
    """A mesh asked at nodes of the fine lattice, which are integers."""

    _scene: Any  # Open3D's, which is untyped
    _lines: tuple[tuple[Any, Any, Any], ...]  # what lattice lines along x, y, z cross
    _by_parity: bool
    step_mm: float  # of the coarse lattice
    shape: tuple[int, int, int]  # nodes of the fine lattice
    notes: tuple[str, ...]

    @classmethod
    def of(cls, mesh: Mesh, origin: Doubles, step_mm: float, cells: tuple[int, int, int]) -> _Surface:
        from pipeline.distance_grid_kernels import crossings

        fine_mm = step_mm / _CELLS
        vertices = (np.asarray(mesh.vertices_mm, dtype=np.float64) - origin) / fine_mm
        nx, ny, nz = (_CELLS * n + 1 for n in cells)
        shape, shift = (nx, ny, nz), np.array(_SHIFT)
        found = [crossings(vertices[mesh.triangles], axis, np.array(shape), shift) for axis in range(3)]
        crossed, unbalanced, odd = np.sum([lines[3] for lines in found], axis=0)
        is_open = bool(odd > _OPEN_SHARE * max(int(crossed), 1))
        return cls(
            _scene=_open3d_scene(vertices * fine_mm, mesh.triangles),
            _lines=() if is_open else tuple((first, where, sign) for first, where, sign, _ in found),
            _by_parity=bool(unbalanced > _OPEN_SHARE * max(int(crossed), 1)), step_mm=step_mm, shape=shape,
            notes=(OPEN,) if is_open else (),
        )  # fmt: skip

    def near(self, cells: NDArray[np.int64], coarse: Doubles) -> NDArray[np.int64]:
        """Those coarse cells (n, 3) that the surface's band can reach."""
        half_diagonal = self.step_mm * math.sqrt(3.0) / 2
        at_corner = np.abs(coarse[:-1, :-1, :-1].ravel()) <= 2 * half_diagonal + _BAND * self.step_mm
        cells = cells[at_corner]
        middle_mm = self._distances((cells.astype(np.float64) + 0.5) * self.step_mm)
        return cells[middle_mm <= half_diagonal + _BAND * self.step_mm]

    def signed_mm(self, nodes: NDArray[np.int64], progress: Progress, start: float, share: float) -> Doubles:
        """(n,) signed distances of nodes (n, 3); reports `share` of the progress from `start` on."""
        from pipeline.distance_grid_kernels import inside

        out = np.empty(len(nodes))
        for k in range(0, len(nodes), _BATCH):
            progress.step(start + share * k / len(nodes), "measuring distances to the object")
            part = nodes[k : k + _BATCH]
            points_mm = part.astype(np.float64) * (self.step_mm / _CELLS)
            if not self._lines:
                out[k : k + _BATCH] = self._by_side(points_mm)
                continue
            votes = np.zeros(len(part), dtype=np.int8)
            for axis, (first, where, sign) in enumerate(self._lines):
                inside(part, axis, np.array(self.shape), first, where, sign, self._by_parity, votes)
            out[k : k + _BATCH] = np.where(votes >= 2, -1.0, 1.0) * self._distances(points_mm)
        return out

    def _distances(self, points_mm: Doubles) -> Doubles:
        tensor = _open3d().core.Tensor(points_mm.astype(np.float32))
        return self._scene.compute_distance(tensor).numpy().astype(np.float64)

    def _by_side(self, points_mm: Doubles) -> Doubles:
        found = self._scene.compute_closest_points(_open3d().core.Tensor(points_mm.astype(np.float32)))
        away = points_mm - found["points"].numpy()
        side = np.einsum("ij,ij->i", away, found["primitive_normals"].numpy())
        return np.where(side < 0, -1.0, 1.0) * np.linalg.norm(away, axis=1)


def _open3d() -> Any:
    import open3d

    return cast("Any", open3d)


def _open3d_scene(vertices_mm: Doubles, triangles: Indices) -> Any:
    o3d = _open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices_mm.astype(np.float32)), o3d.core.Tensor(np.asarray(triangles).astype(np.uint32))
    )
    return scene
