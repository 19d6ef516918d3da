"""Drawing a cloud in a camera's image: as the points that it is, or as the surface that its pixel grid spans."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Indices, Mask
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera

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
    counts: NDArray[np.int64]  # of triangles by fate, see surface_kernels
    as_points: bool = False  # a touch too small for a surface


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """The target's membrane as the loops take it."""

    x0_mm: float
    y0_mm: float
    per_mm: float
    z_mm: Doubles


def splatted(points_mm: Floats, source_index: Indices, camera: Camera, rest: Rest) -> Drawing:
    """Each point in the one pixel that it falls on, the nearest winning; the membrane is asked for every point."""
    from pipeline.stages.project import project_kernels as kernels

    depth_mm, source, pixel, (n_inside, n_drawn) = zbuffer(points_mm, source_index, camera)
    contact = np.zeros(source.size, dtype=np.bool_)
    kernels.touching_points(points_mm, pixel, rest.x0_mm, rest.y0_mm, rest.per_mm, rest.z_mm, contact)
    return Drawing(
        depth_mm=depth_mm, source=source, contact=contact, pixel=pixel, n_inside=n_inside, n_drawn=n_drawn,
        counts=np.zeros(7, dtype=np.int64),
    )  # fmt: skip


def zbuffer(
    points_mm: Floats, source_index: Indices, camera: Camera
) -> tuple[Floats, Indices, Indices, tuple[int, int]]:
    """(depth of each pixel, the point in it, the pixel of each point, (points in view, pixels drawn)) of a splat.

    Depth is mm, NaN = nothing; the nearest point wins and equal depths go to the smaller `source_index`, so the order
    of the points changes nothing.
    """
    from pipeline.stages.project import project_kernels as kernels

    n = camera.rows * camera.cols
    pixel = np.empty(len(points_mm), dtype=np.int32)
    depth_mm, source = np.full(n, np.nan, dtype=np.float32), np.full(n, -1, dtype=np.int32)
    n_inside = kernels.to_pixels(points_mm.reshape(-1), lens_of(camera), camera.shape, MIN_DEPTH_MM, pixel)
    n_drawn = kernels.nearest(points_mm, source_index, pixel, depth_mm, source)
    return depth_mm, source, pixel, (int(n_inside), int(n_drawn))


def rasterised(
    points_mm: Floats,
    source_index: Indices,
    grid_shape: tuple[int, int],
    stride: int,
    camera: Camera,
    rest: Rest,
    limits: tuple[float, float],
) -> Drawing:
    """The source grid as triangles; points without neighbours as points. The membrane is asked in every pixel.

    `limits` are the longest edge beyond the usual spacing, mm, and the flattest angle to a normal, degrees.
    """
    from pipeline.stages.project import project_kernels, surface_kernels

    n = camera.rows * camera.cols
    inverse_z, source = np.zeros(n, dtype=np.float64), np.full(n, -1, dtype=np.int32)
    alone, counts = np.zeros(len(points_mm), dtype=np.bool_), np.zeros(7, dtype=np.int64)
    pixel = np.empty(len(points_mm), dtype=np.int32)
    flat = points_mm.reshape(-1)
    n_inside = project_kernels.to_pixels(flat, lens_of(camera), camera.shape, MIN_DEPTH_MM, pixel)
    order = _sequence(source_index)
    longest_mm = limits[0] + 2.0 * _spacing_mm(flat, source_index, order, stride)  # a diagonal, on a slope
    surface_kernels.rasterise(
        flat, source_index, order, grid_shape[1], stride, lens_of(camera), camera.shape, MIN_DEPTH_MM,
        (longest_mm * longest_mm, math.cos(math.radians(limits[1]))), inverse_z, source, alone, counts,
    )  # fmt: skip
    as_points = bool(n_inside and not counts.any() and not (source >= 0).any())
    # A pixel without neighbours spans no triangle; it is kept as the point that it is.
    if as_points or alone.any():
        project_kernels.splat(points_mm, alone | as_points, source_index, pixel, inverse_z, source)
    depth_mm, contact = np.empty(n, dtype=np.float32), np.empty(n, dtype=np.bool_)
    n_drawn = project_kernels.touching_pixels(
        inverse_z, *camera.rays(), rest.x0_mm, rest.y0_mm, rest.per_mm, rest.z_mm, source, depth_mm, contact
    )
    return Drawing(
        depth_mm=depth_mm, source=source, contact=contact, pixel=pixel, n_inside=int(n_inside), n_drawn=int(n_drawn),
        counts=counts, as_points=as_points and not bool(alone.all()),
    )  # fmt: skip


def lens_of(camera: Camera) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) in px."""
    return float(camera.fx_px), float(camera.fy_px), float(camera.cx_px), float(camera.cy_px)


def _sequence(source_index: Indices) -> Indices:
    """The points by source pixel; empty when they come so already."""
    from pipeline.stages.project import surface_kernels as kernels

    if kernels.is_sorted(source_index):
        return np.empty(0, dtype=np.int32)
    return np.argsort(source_index, kind="stable").astype(np.int32)


def _spacing_mm(flat: Floats, source_index: Indices, order: Indices, stride: int) -> float:
    """The usual distance of neighbouring points, 0 when none has a neighbour."""
    from pipeline.stages.project import surface_kernels as kernels

    distances = np.empty(_SPACING_SAMPLES, dtype=np.float64)
    every = max(1, len(source_index) // _SPACING_SAMPLES)
    n = kernels.neighbour_distances(flat, source_index, order, stride, every, MIN_DEPTH_MM, distances)
    if n == 0 and every > 1:
        n = kernels.neighbour_distances(flat, source_index, order, stride, 1, MIN_DEPTH_MM, distances)
    if n == 0:
        return 0.0
    low, high = (n - 1) // 2, n // 2  # as np.median, at a third of its time
    return float(sum(np.partition(distances[:n], (low, high))[[low, high]]) / 2.0)
