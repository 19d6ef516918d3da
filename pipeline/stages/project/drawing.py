"""Drawing a cloud in a camera's image: as the points that it is, or as the surface that its pixel grid spans."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Indices, Mask, freeze
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.geometry.membrane import Membrane
from pipeline.values.results import Cloud

SAME_SURFACE_MM = 0.2  # a point this close behind what its pixel shows is part of it, not hidden by it
_SPACING_SAMPLES = 1024  # neighbours looked at to learn how far apart source pixels are


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """What the loops saw, all of it flat; nothing is drawn in a pixel whose `source` is -1."""

    depth_mm: Floats  # (rows * cols,) NaN = nothing there
    source: Indices  # (rows * cols,) the point drawn there
    contact: Mask  # (rows * cols,) reaches the membrane
    pixel: Indices  # (n,) the pixel that each point falls on, -1 = not in the image
    n_inside: int
    n_drawn: int
    counts: NDArray[np.int64]  # of triangles by fate, see triangle_kernels
    n_veiled: int = 0  # pixels of what lies behind triangles that were left out
    as_points: bool = False  # a touch too small for a surface


def splatted(cloud: Cloud, camera: Camera, membrane: Membrane) -> Drawing:
    """Each point in the one pixel that it falls on, the nearest winning; the membrane is asked for every point."""
    from pipeline.stages.project import project_kernels as kernels
    from pipeline.stages.project.triangle_kernels import N_COUNTS

    depth_mm, source, pixel, (n_inside, n_drawn) = zbuffer(cloud, camera)
    contact = np.zeros(source.size, dtype=np.bool_)
    kernels.touching_points(flat(cloud.points_mm), pixel, _rest_of(membrane), contact)
    return Drawing(
        depth_mm=depth_mm, source=source, contact=contact, pixel=pixel, n_inside=n_inside, n_drawn=n_drawn,
        counts=np.zeros(N_COUNTS, dtype=np.int64),
    )  # fmt: skip


def zbuffer(cloud: Cloud, camera: Camera) -> tuple[Floats, Indices, Indices, tuple[int, int]]:
    """(depth of each pixel, the point in it, the pixel of each point, (points in view, pixels drawn)) of a splat.

    Depth is mm, NaN = nothing; the nearest point wins and equal depths go to the smaller `source_index`, so the order
    of the points changes nothing.
    """
    from pipeline.stages.project import project_kernels as kernels

    n, points = camera.rows * camera.cols, flat(cloud.points_mm)
    pixel = np.empty(len(cloud.points_mm), dtype=np.int32)
    depth_mm, source = np.full(n, np.nan, dtype=np.float32), np.full(n, -1, dtype=np.int32)
    n_inside = kernels.to_pixels(points, lens_of(camera), pixel)
    n_drawn = kernels.nearest(points, flat(cloud.source_index, np.int32), pixel, depth_mm, source)
    return depth_mm, source, pixel, (int(n_inside), int(n_drawn))


def rasterised(cloud: Cloud, camera: Camera, membrane: Membrane, *, jump_mm: float, grazing_deg: float) -> Drawing:
    """The source grid as triangles; points without neighbours as points. The membrane is asked in every pixel.

    Left out are triangles with an edge `jump_mm` longer than the usual spacing, and those seen flatter than
    `grazing_deg` from their normal; what lies behind the latter is hidden all the same.
    """
    from pipeline.stages.project import project_kernels as kernels
    from pipeline.stages.project.triangle_kernels import GRAZING

    n, points, index = camera.rows * camera.cols, flat(cloud.points_mm), flat(cloud.source_index, np.int32)
    if (index[1:] < index[:-1]).any():
        return _in_turn(cloud, camera, membrane, jump_mm=jump_mm, grazing_deg=grazing_deg)
    longest_mm = jump_mm + 2.0 * _spacing_mm(points, index, cloud.stride)  # a diagonal, on a slope
    image = (np.zeros(n), np.zeros(n), np.full(n, -1, dtype=np.int32))
    limits = (longest_mm * longest_mm, math.cos(math.radians(grazing_deg)))
    pixel, n_inside, alone, counts = _triangles(cloud, lens_of(camera), limits, image)
    as_points = bool(n_inside and not counts[0].any() and not (image[2] >= 0).any())
    # A pixel without neighbours spans no triangle; it is kept as the point that it is.
    if as_points or alone.any():
        kernels.splat(points, alone | as_points, index, pixel, image)
    depth_mm, contact = np.empty(n, dtype=np.float32), np.empty(n, dtype=np.bool_)
    n_drawn, n_veiled = kernels.touching_pixels(
        image, bool(counts[:, GRAZING].any()), SAME_SURFACE_MM, camera.rays(), _rest_of(membrane), depth_mm, contact
    )
    return Drawing(
        depth_mm=depth_mm, source=image[2], contact=contact, pixel=pixel, n_inside=n_inside, n_drawn=int(n_drawn),
        n_veiled=int(n_veiled), counts=counts[0], as_points=as_points and not bool(alone.all()),
    )  # fmt: skip


def _in_turn(cloud: Cloud, camera: Camera, membrane: Membrane, *, jump_mm: float, grazing_deg: float) -> Drawing:
    """As `rasterised`, of points that do not come in the order of their source pixels."""
    order = np.argsort(cloud.source_index, kind="stable").astype(np.int32)
    in_turn = replace(cloud, points_mm=cloud.points_mm[order], source_index=cloud.source_index[order])
    drawing = rasterised(in_turn, camera, membrane, jump_mm=jump_mm, grazing_deg=grazing_deg)
    pixel = np.empty_like(drawing.pixel)
    pixel[order] = drawing.pixel
    return replace(drawing, source=np.where(drawing.source >= 0, order[drawing.source], np.int32(-1)), pixel=pixel)


def flat(array: NDArray[Any], kind: type = np.float32) -> NDArray[Any]:
    """The array in one row, of one type and read-only: what the loops are compiled for, once."""
    return freeze(np.ascontiguousarray(array, dtype=kind).reshape(-1))


def lens_of(camera: Camera) -> tuple[float, float, float, float, int, int, float]:
    """The camera as the loops take it, see project_kernels."""
    focal, centre = (float(camera.fx_px), float(camera.fy_px)), (float(camera.cx_px), float(camera.cy_px))
    return *focal, *centre, int(camera.rows), int(camera.cols), MIN_DEPTH_MM


def _rest_of(membrane: Membrane) -> tuple[float, float, float, Doubles]:
    z_mm = flat(membrane.z_mm, np.float64).reshape(membrane.z_mm.shape)
    return float(membrane.x0_mm), float(membrane.y0_mm), float(1.0 / membrane.step_mm), z_mm


def _triangles(
    cloud: Cloud, lens: tuple[float, ...], limits: tuple[float, float], image: tuple[NDArray[Any], ...]
) -> tuple[Indices, int, Mask, NDArray[np.int64]]:
    """Draw the triangles of points in turn.

    (The pixel of each point, how many are in view, which points have no neighbours to form a triangle with, how many
    triangles by fate: of the touch, and of its rim.)
    """
    from pipeline.stages.project import surface_kernels as surface
    from pipeline.stages.project import triangle_kernels as triangles

    points, index = flat(cloud.points_mm), flat(cloud.source_index, np.int32)
    n, spare = len(index), triangles.RIM_ROOM
    screen, centres = np.empty((3, n + spare)), np.empty((2, n + spare), dtype=np.int32)
    corners = (points, np.empty(3 * spare), *screen, *centres, np.empty(spare, dtype=np.uint32))
    pixel, state, alone = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.uint8), np.zeros(n, dtype=np.bool_)
    n_inside = surface.see(lens, corners, state, pixel)
    starts, bounds, grid = _cells(index, cloud.grid_shape[1], cloud.stride)
    bits = np.zeros((2, *grid), dtype=np.uint8)
    cells = (np.full(grid, surface.NONE), bits[0], np.zeros(grid, dtype=np.int64), bits[1])
    unrolled = tuple(each.reshape(-1) for each in cells)
    surface.place(index, starts, bounds, cloud.stride, state, corners, unrolled, alone)
    todo, late = np.empty(2 * bits[0].size, dtype=np.uint32), np.empty(grid[1], dtype=np.uint32)
    n_todo, n_behind = surface.tell_apart(cells, todo, late)
    surface.find_lonely(cells, alone)
    counts = np.zeros((2, triangles.N_COUNTS), dtype=np.int64)
    counts[0, triangles.BEHIND] = n_behind
    triangles.draw(todo[:n_todo], cells[0], corners, lens, limits, image, counts)
    return pixel, int(n_inside), alone, counts


def _cells(
    index: Indices, grid_cols: int, stride: int
) -> tuple[NDArray[np.intp], tuple[int, int, int, int], tuple[int, int]]:
    """Where each source row begins in the points; what they span, as `place` takes it; and the size of the cells.

    The cells are every `stride`-th source pixel in each direction, and an empty one all round.
    """
    top, bottom = int(index[0]) // grid_cols, int(index[-1]) // grid_cols
    row = np.arange(top, bottom + 2, dtype=np.int32) * np.int32(grid_cols)
    starts = np.searchsorted(index, row)
    filled = starts[1:] > starts[:-1]
    left = int((index[starts[:-1][filled]] - row[:-1][filled]).min())
    right = int((index[starts[1:][filled] - 1] - row[:-1][filled]).max())
    cols = right // stride - left // stride + 3
    return starts, (top, left, grid_cols, cols), (bottom // stride - top // stride + 3, cols)


def _spacing_mm(points: Floats, index: Indices, stride: int) -> float:
    """The usual distance of neighbouring points, 0 when none has a neighbour."""
    from pipeline.stages.project import surface_kernels as kernels

    squares = np.empty(_SPACING_SAMPLES, dtype=np.float64)
    for every in (max(1, len(index) // _SPACING_SAMPLES), 1):
        n = kernels.neighbour_distances(points, index, stride, every, MIN_DEPTH_MM, squares)
        if n > 0:
            low, high = (n - 1) // 2, n // 2  # as np.median, at a third of its time
            return float(np.sqrt(np.partition(squares[:n], (low, high))[[low, high]]).sum() / 2.0)
    return 0.0
