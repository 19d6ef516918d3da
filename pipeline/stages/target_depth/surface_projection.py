"""Projection of the cloud into the target sensor's camera (paper, eqs. D_T'' and M_T'').

`PointSplatParams` selects the point splat of the equations. `SurfaceProjectionParams` rasterises
the source pixel grid as triangles, with 1/Z interpolated linearly in screen space: no holes, and
hundreds of times less error (benchmarks/reprojection.py).
"""

from dataclasses import dataclass

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.errors import ShapeError, describe_no_contact
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import SAME_SURFACE_MM, Cloud, TargetDepth
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.target_depth import projection_notes
from pipeline.stages.target_depth.rasterisation import (
    Rasterisation,
    assign_pixels,
    flatten_read_only,
    pack_camera,
    rasterise_surface,
    splat_cloud,
)

_EMPTY = "the target depth is empty"
_NEXT_CORNER = [1, 2, 3, 0]  # next corner of a quadrilateral
_SUBPIXELS = 4  # per side of a pixel, for sub-pixel coverage


@dataclass(frozen=True, slots=True, kw_only=True)
class PointSplatParams:
    """The point splat has no parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceProjectionParams:
    """How the surface is rasterised."""

    jump_mm: float = setting(
        1.0,
        "Depth jump",
        unit="mm",
        low=0.01,
        high=50.0,
        step=0.1,
        help="neighbours farther apart than this plus their usual spacing are not connected",
        source="the paper, eqs. D_T'' and M_T'', on surfaces",
    )
    grazing_deg: float = setting(
        84.0,
        "Grazing limit",
        unit="deg",
        low=1.0,
        high=90.0,
        step=1.0,
        help="triangles whose normal is farther than this from the line of sight are omitted",
        source="the paper, eqs. D_T'' and M_T'', on surfaces",
    )
    compute_coverage: bool = setting(
        False,
        "Sub-pixel coverage",
        help="also compute the share of each target pixel in contact, in sixteenths",
        source="the paper's M_T'', evaluated at 16 points per pixel",
    )


ProjectionParams = SurfaceProjectionParams | PointSplatParams


def project_cloud(
    cloud: Cloud, target: SensorSpec, params: ProjectionParams, progress: Progress = SILENT
) -> TargetDepth:
    """Depth, contact mask and indentation (rows, cols) in the target camera.

    The nearest surface wins each pixel.

    The mask is the test SDF(p, M_target) <= 0 on the target's rest surface as a height field, whose
    sign is exact: for every point as in the paper, or for the surface point of each pixel.
    `pixel_of_point` is -1 for a point more than SAME_SURFACE_MM behind its pixel and the eight
    around it. Raises ShapeError for an inconsistent cloud.
    """
    empty = skip_without_contact(cloud, target, params)
    if empty is not None:
        return empty
    _check_cloud(cloud)
    progress.step(0.0, "rasterising the cloud in the target image")
    view = project_checked_cloud(cloud, target, params)
    progress.step(1.0, "drawn")
    return view


def project_checked_cloud(
    cloud: Cloud, target: SensorSpec, params: ProjectionParams
) -> TargetDepth:
    """`project_cloud` without checks, of a cloud with at least one point."""
    from pipeline.stages.target_depth import projection_kernels as kernels

    surface = None if isinstance(params, PointSplatParams) else params
    pixel, n_inside = assign_pixels(cloud, target.camera)
    if surface is None:
        rasterisation = splat_cloud(cloud, target.camera, target.membrane, pixel)
    else:
        rasterisation = _rasterise(cloud, target.camera, target, surface)
    shape = target.camera.shape
    pushed = target.rest_depth_mm.reshape(-1) - rasterisation.depth_mm
    indentation = np.where(rasterisation.contact & (pushed > 0.0), pushed, 0.0).astype(np.float32)
    n_contact = int(np.count_nonzero(rasterisation.contact))
    n_hidden: int = kernels.mark_hidden_points(
        flatten_read_only(cloud.points_mm),
        rasterisation.depth_mm,
        pack_camera(target.camera),
        SAME_SURFACE_MM,
        pixel,
    )
    if surface is None:
        drawing_notes = projection_notes.note_shared_pixels(n_inside, rasterisation.n_drawn_px)
    else:
        drawing_notes = projection_notes.note_omitted_triangles(
            rasterisation, surface.jump_mm, surface.grazing_deg, int(n_hidden)
        )
    return TargetDepth(
        depth_mm=freeze(rasterisation.depth_mm.reshape(shape)),
        contact=freeze(rasterisation.contact.reshape(shape)),
        indentation_mm=freeze(indentation.reshape(shape)),
        camera=target.camera,
        source_index=freeze(rasterisation.point_index.reshape(shape)),
        in_view=_compute_field_of_view(cloud, target),
        notes=(
            *projection_notes.note_visibility(rasterisation, n_inside, cloud.points_mm),
            *drawing_notes,
            *projection_notes.note_contact(
                target,
                n_drawn=rasterisation.n_drawn_px,
                n_contact=n_contact,
                gap_mm=0.0
                if n_contact
                else _measure_gap_mm(cloud.points_mm[pixel >= 0], rasterisation, target, surface),
                deepest_mm=float(indentation.max()),
            ),
        ),
        pixel_of_point=freeze(pixel),
        coverage=_compute_coverage(cloud, target, surface)
        if surface is not None and surface.compute_coverage
        else None,
        error=cloud.error,
    )


def skip_without_contact(
    cloud: Cloud, target: SensorSpec, params: ProjectionParams
) -> TargetDepth | None:
    """The empty target depth if the cloud is empty, else None; same inputs as `project_cloud`."""
    if cloud.points_mm.shape[0] > 0:
        return None
    shape = target.camera.shape
    with_coverage = isinstance(params, SurfaceProjectionParams) and params.compute_coverage
    return TargetDepth(
        depth_mm=freeze(np.full(shape, np.nan, dtype=np.float32)),
        contact=freeze(np.zeros(shape, dtype=np.bool_)),
        indentation_mm=freeze(np.zeros(shape, dtype=np.float32)),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, dtype=np.int32)),
        in_view=_compute_field_of_view(cloud, target),
        notes=(describe_no_contact(_EMPTY, cloud.notes),),
        pixel_of_point=freeze(np.empty(0, dtype=np.int32)),
        coverage=freeze(np.zeros(shape, dtype=np.float32)) if with_coverage else None,
    )


def _compute_field_of_view(cloud: Cloud, target: SensorSpec) -> Mask:
    """Target pixels inside the source's field of view; none if that reaches behind the camera."""
    rows, cols = target.camera.shape
    if not (cloud.field_of_view_mm[:, 2] > MIN_DEPTH_MM).all():
        return freeze(np.zeros((rows, cols), dtype=np.bool_))
    with np.errstate(all="ignore"):
        x_px, y_px, _ = target.camera.project(cloud.field_of_view_mm)
        return freeze(_rasterise_polygon(x_px, y_px, rows, cols))


def _rasterise_polygon(x_px: Doubles, y_px: Doubles, rows: int, cols: int) -> Mask:
    """Pixels (rows, cols) whose centre lies in a convex polygon with corners in order, as a
    column range per row.
    """
    to_x = x_px[_NEXT_CORNER]
    to_y = y_px[_NEXT_CORNER]
    row = np.arange(rows)
    sign = -1.0 if (x_px * to_y - to_x * y_px).sum() < 0.0 else 1.0
    # Inside means a * col + b >= 0 for every edge.
    a = sign * (y_px - to_y)
    b = sign * ((to_x - x_px)[:, None] * (row - y_px[:, None]) + ((to_y - y_px) * x_px)[:, None])
    left = a > 0.0
    right = a < 0.0
    level = a == 0.0
    # integers compare twice as fast
    bound = b / -a[:, None]
    col = np.arange(cols, dtype=np.int32)
    first = np.ceil(bound[left].max(axis=0, initial=0.0)).clip(0, cols)
    last = np.floor(bound[right].min(axis=0, initial=cols - 1.0)).clip(-1, cols - 1)
    last[(b[level] < 0.0).any(axis=0)] = -1.0
    return (col >= first.astype(np.int32)[:, None]) & (col <= last.astype(np.int32)[:, None])


def _check_cloud(cloud: Cloud) -> None:
    n, (rows, cols) = cloud.points_mm.shape[0], cloud.grid_shape
    if cloud.points_mm.shape != (n, 3) or cloud.source_index.shape != (n,):
        raise ShapeError(
            f"a cloud needs points (n, 3) and one source_index each, "
            f"got {cloud.points_mm.shape} and {cloud.source_index.shape}"
        )
    if cloud.source_index.min() < 0 or cloud.source_index.max() >= rows * cols:
        raise ShapeError(
            f"source_index of the cloud points outside its grid of {rows} x {cols} pixels"
        )


def _measure_gap_mm(
    seen: Floats | Doubles,
    rasterisation: Rasterisation,
    target: SensorSpec,
    surface: SurfaceProjectionParams | None,
) -> float:
    """Smallest signed distance to the membrane, of the visible points or of the surface points
    of the pixels.
    """
    if surface is not None:
        row, col = np.nonzero(rasterisation.point_index.reshape(target.camera.shape) >= 0)
        ray_x, ray_y = target.camera.rays()
        z = rasterisation.depth_mm[rasterisation.point_index >= 0].astype(np.float64)
        seen = np.stack([z * ray_x[col], z * ray_y[row], z], axis=-1)
    return float(target.membrane.signed_distance_mm(seen).min(initial=np.inf))


def _rasterise(
    cloud: Cloud, camera: Camera, target: SensorSpec, params: SurfaceProjectionParams
) -> Rasterisation:
    return rasterise_surface(
        cloud, camera, target.membrane, jump_mm=params.jump_mm, grazing_deg=params.grazing_deg
    )


def _compute_coverage(cloud: Cloud, target: SensorSpec, params: SurfaceProjectionParams) -> Floats:
    """Share of each pixel (rows, cols) covered by the surface in contact, from 4 x 4 sub-pixels."""
    (rows, cols), fine = target.camera.shape, target.camera.scale(_SUBPIXELS)
    contact = _rasterise(cloud, fine, target, params).contact
    return freeze(
        contact.reshape(rows, _SUBPIXELS, cols, _SUBPIXELS).mean(axis=(1, 3), dtype=np.float32)
    )
