"""Rasterisation of a cloud in a camera image, as points or as the surface of its pixel grid."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Indices, Mask, freeze
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.membrane import Membrane
from pipeline.core.values.results import SAME_SURFACE_MM, Cloud

_CELLS_PER_STRIP = 8192  # cells processed at once, so that they stay in cache
_SPACING_SAMPLES = 1024  # neighbour pairs that the point spacing is estimated from


@dataclass(frozen=True, slots=True, kw_only=True)
class Rasterisation:
    """Result of a rasterisation, all flat.

    Nothing is drawn in a pixel whose `point_index` is -1.
    """

    depth_mm: Floats  # (rows * cols,) NaN = nothing there
    point_index: Indices  # (rows * cols,) the point drawn there
    contact: Mask  # (rows * cols,) reaches the membrane
    n_drawn_px: int
    triangle_counts: NDArray[np.int64]  # triangles by outcome, see triangle_batch_kernels
    n_veiled_px: int = 0  # pixels hidden by omitted triangles
    is_point_splat: bool = False  # the touch was too small for a surface


def splat_cloud(cloud: Cloud, camera: Camera, membrane: Membrane, pixel: Indices) -> Rasterisation:
    """Draw each point in its pixel, the nearest winning; contact is tested for every point."""
    from pipeline.stages.target_depth import projection_kernels as kernels
    from pipeline.stages.target_depth.triangle_batch_kernels import N_COUNTS

    depth_mm, source, n_drawn = compute_zbuffer(cloud, camera, pixel)
    contact = np.zeros(source.size, dtype=np.bool_)
    kernels.mark_contact_points(
        flatten_read_only(cloud.points_mm), pixel, _pack_membrane(membrane), contact
    )
    return Rasterisation(
        depth_mm=depth_mm,
        point_index=source,
        contact=contact,
        n_drawn_px=n_drawn,
        triangle_counts=np.zeros(N_COUNTS, dtype=np.int64),
    )


def compute_zbuffer(cloud: Cloud, camera: Camera, pixel: Indices) -> tuple[Floats, Indices, int]:
    """(depth of each pixel in mm, NaN = nothing.

    The point in it; number of pixels drawn) of a splat.

    `pixel` (n,) is the pixel of each point. The nearest point wins, ties go to the smaller
    `source_index`: the order of the points has no effect.
    """
    from pipeline.stages.target_depth import projection_kernels as kernels

    n = camera.rows * camera.cols
    index = flatten_read_only(cloud.source_index, np.int32)
    depth_mm = np.full(n, np.nan, dtype=np.float32)
    source = np.full(n, -1, dtype=np.int32)
    return (
        depth_mm,
        source,
        int(
            kernels.fill_zbuffer(flatten_read_only(cloud.points_mm), index, pixel, depth_mm, source)
        ),
    )


def assign_pixels(cloud: Cloud, camera: Camera) -> tuple[Indices, int]:
    """(flat pixel of each point (n,), -1 = outside the image; number of points inside)."""
    from pipeline.stages.target_depth import projection_kernels as kernels

    pixel = np.empty(len(cloud.points_mm), dtype=np.int32)
    n_inside = kernels.project_points(
        flatten_read_only(cloud.points_mm), pack_camera(camera), pixel
    )
    return pixel, int(n_inside)


def rasterise_surface(
    cloud: Cloud, camera: Camera, membrane: Membrane, *, jump_mm: float, grazing_deg: float
) -> Rasterisation:
    """Rasterise the source grid as triangles, isolated points as points.

    Contact is tested in every pixel.

    Triangles with an edge `jump_mm` longer than the usual spacing, and those seen flatter than
    `grazing_deg` from their normal, are omitted; the latter still hide what lies behind them.
    """
    from pipeline.stages.target_depth import projection_kernels as kernels
    from pipeline.stages.target_depth.triangle_batch_kernels import GRAZING

    n = camera.rows * camera.cols
    points = flatten_read_only(cloud.points_mm)
    index = flatten_read_only(cloud.source_index, np.int32)
    if not index.size:
        return splat_cloud(cloud, camera, membrane, index)
    if (index[1:] < index[:-1]).any():
        return _rasterise_unordered(
            cloud, camera, membrane, jump_mm=jump_mm, grazing_deg=grazing_deg
        )
    # the diagonal of a cell on a slope
    longest_mm = jump_mm + 2.0 * _measure_spacing_mm(points, index, cloud.stride)
    image = (np.zeros(n), np.zeros(n), np.full(n, -1, dtype=np.int32))
    limits = (longest_mm * longest_mm, math.cos(math.radians(grazing_deg)))
    alone, counts = _rasterise_triangles(cloud, pack_camera(camera), limits, image)
    splats_points = not counts[0].any() and not (image[2] >= 0).any()
    # A pixel without neighbours forms no triangle; it is drawn as a point.
    if splats_points or alone.any():
        splats_points &= (
            kernels.splat_points(points, alone | splats_points, index, pack_camera(camera), image)
            > 0
        )
    depth_mm = np.empty(n, dtype=np.float32)
    contact = np.empty(n, dtype=np.bool_)
    n_drawn, n_veiled = kernels.resolve_depth_and_contact(
        image,
        bool(counts[:, GRAZING].any()),
        SAME_SURFACE_MM,
        camera.rays(),
        _pack_membrane(membrane),
        depth_mm,
        contact,
    )
    return Rasterisation(
        depth_mm=depth_mm,
        point_index=image[2],
        contact=contact,
        n_drawn_px=int(n_drawn),
        n_veiled_px=int(n_veiled),
        triangle_counts=counts[0],
        is_point_splat=splats_points and not bool(alone.all()),
    )


def _rasterise_unordered(
    cloud: Cloud, camera: Camera, membrane: Membrane, *, jump_mm: float, grazing_deg: float
) -> Rasterisation:
    """`rasterise_surface` of points that are not in the order of their source pixels."""
    order = np.argsort(cloud.source_index, kind="stable").astype(np.int32)
    ordered = replace(
        cloud, points_mm=cloud.points_mm[order], source_index=cloud.source_index[order]
    )
    rasterisation = rasterise_surface(
        ordered, camera, membrane, jump_mm=jump_mm, grazing_deg=grazing_deg
    )
    return replace(
        rasterisation,
        point_index=np.where(
            rasterisation.point_index >= 0, order[rasterisation.point_index], np.int32(-1)
        ),
    )


def flatten_read_only(array: NDArray[Any], kind: type = np.float32) -> NDArray[Any]:
    """The array flat, of one dtype and read-only: the single signature that the kernels are
    compiled for.
    """
    return freeze(np.ascontiguousarray(array, dtype=kind).reshape(-1))


def pack_camera(camera: Camera) -> tuple[float, float, float, float, int, int, float]:
    """The camera as the `lens` tuple of `projection_kernels`."""
    focal = (float(camera.fx_px), float(camera.fy_px))
    centre = (float(camera.cx_px), float(camera.cy_px))
    return *focal, *centre, int(camera.rows), int(camera.cols), MIN_DEPTH_MM


def _pack_membrane(membrane: Membrane) -> tuple[float, float, float, Doubles]:
    z_mm = flatten_read_only(membrane.z_mm, np.float64).reshape(membrane.z_mm.shape)
    return float(membrane.x0_mm), float(membrane.y0_mm), float(1.0 / membrane.step_mm), z_mm


def _rasterise_triangles(
    cloud: Cloud,
    lens: tuple[float, ...],
    limits: tuple[float, float],
    image: tuple[NDArray[Any], ...],
) -> tuple[Mask, NDArray[np.int64]]:
    """Rasterise the triangles of ordered points.

    Returns which points have no neighbours to form a triangle (n,), and counts of triangles by
    outcome: of the surface, and of its rim.
    """
    from pipeline.stages.target_depth import triangle_batch_kernels as batch_kernels
    from pipeline.stages.target_depth import triangle_kernels as triangles

    points = flatten_read_only(cloud.points_mm)
    index = flatten_read_only(cloud.source_index, np.int32)
    starts, bounds, n_rows = _lay_out_rows(index, cloud.grid_shape[1], cloud.stride)
    cols = bounds[3]
    room = triangles.N_RIM_CORNERS
    grid = (min(max(_CELLS_PER_STRIP // cols, 8), n_rows + 4), cols)
    high = min(grid[0] * cloud.stride, len(starts) - 1)  # source rows of a strip
    n = int((starts[high:] - starts[:-high]).max()) + room
    corners = (
        np.empty(4 * room),
        np.empty((3, n)),
        np.empty((2, n), np.int32),
        np.empty(n, np.uint8),
    )
    cells = (
        np.empty(grid, np.uint32),
        np.empty(grid, np.uint8),
        np.zeros(grid, np.int64),
        np.empty(grid, np.uint8),
    )
    lists = (
        np.empty(2 * grid[0] * cols, np.uint32),
        np.empty(cols, np.uint32),
        np.empty(batch_kernels.BATCH_LENGTH),
    )
    alone = np.zeros(len(index), dtype=np.bool_)
    counts = np.zeros((2, batch_kernels.N_COUNTS), dtype=np.int64)
    triangles.rasterise_grid(
        (points, index, starts), bounds, lens, limits, corners, cells, lists, image, counts, alone
    )
    return alone, counts


def _lay_out_rows(
    index: Indices, grid_cols: int, stride: int
) -> tuple[NDArray[np.intp], tuple[int, int, int, int, int], int]:
    """First point of each source row.

    The bounds as `place_corners` takes them; and the number of rows of cells.

    Cells are every `stride`-th source pixel in each direction, with an empty column on either side.
    """
    top = int(index[0]) // grid_cols
    bottom = int(index[-1]) // grid_cols
    row = np.arange(top, bottom + 2, dtype=np.int32) * np.int32(grid_cols)
    starts = np.searchsorted(index, row)
    filled = starts[1:] > starts[:-1]
    left = int((index[starts[:-1][filled]] - row[:-1][filled]).min())
    right = int((index[starts[1:][filled] - 1] - row[:-1][filled]).max())
    cols = right // stride - left // stride + 3
    return starts, (top, left, grid_cols, cols, stride), bottom // stride - top // stride + 1


def _measure_spacing_mm(points: Floats, index: Indices, stride: int) -> float:
    """Median distance of neighbouring points, 0 if none has a neighbour."""
    from pipeline.stages.target_depth import quad_kernels as kernels

    squares = np.empty(_SPACING_SAMPLES, dtype=np.float64)
    for every in (max(1, len(index) // _SPACING_SAMPLES), 1):
        n = kernels.measure_neighbour_distances(points, index, stride, every, MIN_DEPTH_MM, squares)
        if n > 0:
            # np.median takes three times as long
            low = (n - 1) // 2
            high = n // 2
            return float(np.sqrt(np.partition(squares[:n], (low, high))[[low, high]]).sum() / 2.0)
    return 0.0
