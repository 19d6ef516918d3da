"""Projection: the cloud as the target sensor's camera sees it (paper, eqs. D_T'' and M_T'').

With `PaperParams` it is the point splat of the equations. With `ProjectParams` the source pixel grid is drawn as
triangles instead, with 1/Z interpolated linearly in screen space: no holes, and hundreds of times less error
(benchmarks/reprojection.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Mask, freeze
from pipeline.base.errors import ShapeError
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.target_depth import projection_notes
from pipeline.stages.target_depth.rasterisation import (
    SAME_SURFACE_MM,
    Rasterisation,
    assign_pixels,
    flatten_read_only,
    pack_camera,
    rasterise_surface,
    splat_cloud,
)
from pipeline.values.results import Cloud, TargetDepth

NO_CONTACT = "no contact: the target sees nothing"
_NEXT = [1, 2, 3, 0]  # corner of a window
_FINER = 4  # pixels along each side of one, where its coverage is asked for


@dataclass(frozen=True, slots=True, kw_only=True)
class PointSplatParams:
    """The cloud is drawn as single points, which leave nothing to set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceProjectionParams:
    """How the cloud is drawn as a surface."""

    jump_mm: float = setting(
        1.0, "Depth jump", unit="mm", low=0.01, high=50.0, step=0.1,
        help="neighbours farther apart than this, beyond their usual spacing, are an edge and not joined",
        source="the paper, eqs. D_T'' and M_T'', on surfaces",
    )  # fmt: skip
    grazing_deg: float = setting(
        84.0, "Grazing limit", unit="deg", low=1.0, high=90.0, step=1.0,
        help="triangles seen at a flatter angle than this from their normal are left out",
        source="the paper, eqs. D_T'' and M_T'', on surfaces",
    )  # fmt: skip
    compute_coverage: bool = setting(
        False, "Sub-pixel coverage", help="also say how much of each target pixel is in contact, in sixteenths",
        source="our own: the paper's M_T'', asked for at 16 points of a pixel",
    )  # fmt: skip


ProjectionParams = SurfaceProjectionParams | PointSplatParams


def project_cloud(
    cloud: Cloud, target: SensorSpec, params: ProjectionParams, progress: Progress = SILENT
) -> TargetDepth:
    """Depth, contact mask and indentation (rows, cols) in the target camera; the nearest surface wins each pixel.

    The mask is the test SDF(p, M_target) <= 0 on the target's rest surface as a height field, whose sign is exact: on
    every point as in the paper, on what each pixel sees of a surface. `pixel_of_point` is -1 for a point more than
    SAME_SURFACE_MM behind what its pixel and the eight around it show. Raises ShapeError when the cloud is not sound.
    """
    empty = skip_without_contact(cloud, target, params)
    if empty is not None:
        return empty
    _check(cloud)
    progress.step(0.0, "drawing the touch in the target image")
    view = project_checked_cloud(cloud, target, params)
    progress.step(1.0, "drawn")
    return view


def project_checked_cloud(cloud: Cloud, target: SensorSpec, params: ProjectionParams) -> TargetDepth:
    """As `project`, of a cloud that is sound and has a point."""
    from pipeline.stages.target_depth import projection_kernels as kernels

    surface = None if isinstance(params, PointSplatParams) else params
    pixel, n_inside = assign_pixels(cloud, target.camera)
    if surface is None:
        drawing = splat_cloud(cloud, target.camera, target.membrane, pixel)
    else:
        drawing = _surface(cloud, target.camera, target, surface)
    shape = target.camera.shape
    pushed = target.rest_depth_mm.reshape(-1) - drawing.depth_mm
    indentation = np.where(drawing.contact & (pushed > 0.0), pushed, 0.0).astype(np.float32)
    n_contact = int(np.count_nonzero(drawing.contact))
    n_hidden = kernels.mark_hidden_points(
        flatten_read_only(cloud.points_mm), drawing.depth_mm, pack_camera(target.camera), SAME_SURFACE_MM, pixel
    )
    return TargetDepth(
        depth_mm=freeze(drawing.depth_mm.reshape(shape)),
        contact=freeze(drawing.contact.reshape(shape)),
        indentation_mm=freeze(indentation.reshape(shape)),
        camera=target.camera,
        source_index=freeze(drawing.point_index.reshape(shape)),
        in_view=_known(cloud, target),
        notes=(
            *projection_notes.note_visibility(drawing, n_inside, cloud.points_mm),
            *_drawing_notes(drawing, n_inside, surface, int(n_hidden)),
            *projection_notes.note_contact(
                target, n_drawn=drawing.n_drawn_px, n_contact=n_contact,
                gap_mm=0.0 if n_contact else _short_mm(cloud.points_mm[pixel >= 0], drawing, target, surface),
                deepest_mm=float(indentation.max()),
            ),
        ),
        pixel_of_point=freeze(pixel),
        coverage=_coverage(cloud, target, surface) if surface is not None and surface.compute_coverage else None,
        error=cloud.error,
    )  # fmt: skip


def skip_without_contact(cloud: Cloud, target: SensorSpec, params: ProjectionParams) -> TargetDepth | None:
    """The view of nothing when the cloud is empty, else None; same inputs as `project`."""
    if cloud.points_mm.shape[0] > 0:
        return None
    shape, asks_coverage = target.camera.shape, isinstance(params, SurfaceProjectionParams) and params.compute_coverage
    return TargetDepth(
        depth_mm=freeze(np.full(shape, np.nan, dtype=np.float32)),
        contact=freeze(np.zeros(shape, dtype=np.bool_)),
        indentation_mm=freeze(np.zeros(shape, dtype=np.float32)),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, dtype=np.int32)),
        in_view=_known(cloud, target),
        notes=(NO_CONTACT,),
        pixel_of_point=freeze(np.empty(0, dtype=np.int32)),
        coverage=freeze(np.zeros(shape, dtype=np.float32)) if asks_coverage else None,
    )


def _known(cloud: Cloud, target: SensorSpec) -> Mask:
    """The target pixels inside the source's window; none of them when the window reaches behind the camera."""
    rows, cols = target.camera.shape
    if not (cloud.field_of_view_mm[:, 2] > MIN_DEPTH_MM).all():
        return freeze(np.zeros((rows, cols), dtype=np.bool_))
    with np.errstate(all="ignore"):
        x_px, y_px, _ = target.camera.project(cloud.field_of_view_mm)
        return freeze(_inside(x_px, y_px, rows, cols))


def _inside(x_px: Doubles, y_px: Doubles, rows: int, cols: int) -> Mask:
    """The pixels (rows, cols) whose centre lies in the convex polygon of corners in turn: from-to in every row."""
    to_x, to_y, row = x_px[_NEXT], y_px[_NEXT], np.arange(rows)
    turned = -1.0 if (x_px * to_y - to_x * y_px).sum() < 0.0 else 1.0
    # Inside is where a * col + b >= 0, for every edge.
    a = turned * (y_px - to_y)
    b = turned * ((to_x - x_px)[:, None] * (row - y_px[:, None]) + ((to_y - y_px) * x_px)[:, None])
    left, right, level = a > 0.0, a < 0.0, a == 0.0
    bound, col = b / -a[:, None], np.arange(cols, dtype=np.int32)  # whole numbers are compared in half the time
    first = np.ceil(bound[left].max(axis=0, initial=0.0)).clip(0, cols)
    last = np.floor(bound[right].min(axis=0, initial=cols - 1.0)).clip(-1, cols - 1)
    last[(b[level] < 0.0).any(axis=0)] = -1.0
    return (col >= first.astype(np.int32)[:, None]) & (col <= last.astype(np.int32)[:, None])


def _check(cloud: Cloud) -> None:
    n, (rows, cols) = cloud.points_mm.shape[0], cloud.grid_shape
    if cloud.points_mm.shape != (n, 3) or cloud.source_index.shape != (n,):
        raise ShapeError(
            f"a cloud needs points (n, 3) and one source_index each, "
            f"got {cloud.points_mm.shape} and {cloud.source_index.shape}"
        )
    if cloud.source_index.min() < 0 or cloud.source_index.max() >= rows * cols:
        raise ShapeError(f"source_index of the cloud points outside its grid of {rows} x {cols} pixels")


def _short_mm(
    seen: Floats | Doubles, drawing: Rasterisation, target: SensorSpec, surface: SurfaceProjectionParams | None
) -> float:
    """The smallest signed distance to the membrane, of the points seen or of what the pixels see of a surface."""
    if surface is not None:
        row, col = np.nonzero(drawing.point_index.reshape(target.camera.shape) >= 0)
        (ray_x, ray_y), z = target.camera.rays(), drawing.depth_mm[drawing.point_index >= 0].astype(np.float64)
        seen = np.stack([z * ray_x[col], z * ray_y[row], z], axis=-1)
    return float(target.membrane.signed_distance_mm(seen).min(initial=np.inf))


def _drawing_notes(
    drawing: Rasterisation, n_inside: int, surface: SurfaceProjectionParams | None, n_hidden: int
) -> tuple[str, ...]:
    if surface is None:
        return projection_notes.note_shared_pixels(n_inside, drawing.n_drawn_px)
    return projection_notes.note_omitted_triangles(drawing, surface.jump_mm, surface.grazing_deg, n_hidden)


def _surface(cloud: Cloud, camera: Camera, target: SensorSpec, params: SurfaceProjectionParams) -> Rasterisation:
    return rasterise_surface(cloud, camera, target.membrane, jump_mm=params.jump_mm, grazing_deg=params.grazing_deg)


def _coverage(cloud: Cloud, target: SensorSpec, params: SurfaceProjectionParams) -> Floats:
    """Share of each pixel (rows, cols) that the surface covers in contact: drawn again with 4 x 4 pixels in each."""
    (rows, cols), fine = target.camera.shape, target.camera.scale(_FINER)
    contact = _surface(cloud, fine, target, params).contact
    return freeze(contact.reshape(rows, _FINER, cols, _FINER).mean(axis=(1, 3), dtype=np.float32))
