"""Rasterisation of a cloud in a camera image, as points or as the surface of its pixel grid."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Indices, Mask, freeze
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.membrane import Membrane
from pipeline.core.values.results import SAME_SURFACE_MM, Cloud

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
    triangle_counts: NDArray[np.int64]  # triangles by outcome, see projection_kernels
    n_veiled_px: int = 0  # pixels hidden by omitted triangles
    is_point_splat: bool = False  # the touch was too small for a surface


def splat_cloud(cloud: Cloud, camera: Camera, membrane: Membrane, pixel: Indices) -> Rasterisation:
    """Draw each point in its pixel (n,); contact is tested for every point.

    The nearest point wins, ties go to the smaller `source_index`: the order of the points has no
    effect.
    """
    from pipeline.stages.target_depth import projection_kernels as kernels

    points = flatten_read_only(cloud.points_mm)
    image = _make_image(camera)
    kernels.splat_points(points, pixel, flatten_read_only(cloud.source_index, np.int32), image)
    contact = np.zeros(image[2].size, dtype=np.bool_)
    kernels.mark_contact_points(points, pixel, _pack_membrane(membrane), contact)
    drawn = image[2] >= 0
    depth_mm = np.full(drawn.size, np.nan, dtype=np.float32)
    depth_mm[drawn] = cloud.points_mm[image[2][drawn], 2]
    return Rasterisation(
        depth_mm=depth_mm,
        point_index=image[2],
        contact=contact,
        n_drawn_px=int(np.count_nonzero(drawn)),
        triangle_counts=np.zeros(kernels.N_COUNTS, dtype=np.int64),
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

    points = flatten_read_only(cloud.points_mm)
    index = flatten_read_only(cloud.source_index, np.int32)
    # the diagonal of a cell on a slope
    longest_mm = jump_mm + 2.0 * _measure_spacing_mm(cloud)
    image = _make_image(camera)
    limits = (longest_mm * longest_mm, math.cos(math.radians(grazing_deg)))
    counts = np.zeros((2, kernels.N_COUNTS), dtype=np.int64)
    linked = np.zeros(len(index), dtype=np.bool_)
    kernels.rasterise_grid(
        points, _lay_out_cells(cloud), pack_camera(camera), limits, image, counts, linked
    )
    # A pixel without neighbours forms no triangle; it is drawn as a point.
    splats_points = not counts[0].any() and not (image[2] >= 0).any()
    pixel, _ = assign_pixels(cloud, camera)
    if not splats_points:
        pixel[linked] = -1
    kernels.splat_points(points, pixel, index, image)
    depth_mm = np.empty(image[2].size, dtype=np.float32)
    contact = np.empty(image[2].size, dtype=np.bool_)
    n_drawn, n_veiled = kernels.resolve_depth_and_contact(
        image,
        bool(counts[:, kernels.GRAZING].any()),
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
        is_point_splat=splats_points and bool(linked.any() and (pixel >= 0).any()),
    )


def _make_image(camera: Camera) -> tuple[Doubles, Doubles, Indices]:
    """Empty buffers of the kernels: 1/z, 1/z of the veil, and the point drawn."""
    n = camera.rows * camera.cols
    return np.zeros(n), np.zeros(n), np.full(n, -1, dtype=np.int32)


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


def _lay_out_cells(cloud: Cloud) -> Indices:
    """The point of every `stride`-th source pixel (rows, cols), -1 = none, inside a frame of empty
    cells.

    Of several points of one pixel the last is taken.
    """
    row, col = np.divmod(cloud.source_index, cloud.grid_shape[1])
    taken = np.flatnonzero((row % cloud.stride == 0) & (col % cloud.stride == 0))
    row, col = (at[taken] // cloud.stride for at in (row, col))
    row, col = (at - at.min(initial=max(cloud.grid_shape)) + 1 for at in (row, col))
    cells = np.full((row.max(initial=0) + 2, col.max(initial=0) + 2), -1, dtype=np.int32)
    cells[row, col] = taken
    return cells


def _measure_spacing_mm(cloud: Cloud) -> float:
    """Median distance of neighbouring points, 0 if none has a neighbour; of many only some."""
    order = np.argsort(cloud.source_index, kind="stable")
    for every in (max(1, len(order) // _SPACING_SAMPLES), 1):
        one = order[:-1:every]
        other = order[1::every]
        with np.errstate(all="ignore"):
            steps_mm = cloud.points_mm[other].astype(np.float64) - cloud.points_mm[one]
            distance_mm = np.linalg.norm(steps_mm, axis=1)
        near = cloud.source_index[other] - cloud.source_index[one] == cloud.stride
        near &= (cloud.points_mm[[one, other], 2] > MIN_DEPTH_MM).all(axis=0)
        near &= np.isfinite(distance_mm)
        if near.any():
            return float(np.median(distance_mm[near][:_SPACING_SAMPLES]))
    return 0.0
