"""Projection of the cloud into the target sensor's camera (paper, eqs. D_T'' and M_T'').

`PointSplatParams` selects the point splat of the equations. `SurfaceProjectionParams` rasterises
the source pixel grid as triangles, with 1/Z interpolated linearly in screen space: no holes, and
hundreds of times less error (benchmarks/reprojection.py).

Rasterisation of a cloud in a camera image, as points or as the surface of its pixel grid.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Indices, Mask, freeze
from pipeline.core.errors import AlignmentWarning, ShapeError, StageWarning, describe_no_contact
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.core.geometry.membrane import Membrane
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import SAME_SURFACE_MM, Cloud, TargetDepth
from pipeline.sensors.spec import SensorSpec

_SPACING_SAMPLES = 1024  # neighbour pairs that the point spacing is estimated from


@frozen
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
    cells = kernels.lay_out_cells(index, cloud.grid_shape[1], cloud.stride)
    image = _make_image(camera)
    limits = (longest_mm * longest_mm, math.cos(math.radians(grazing_deg)))
    counts = np.zeros((2, kernels.N_COUNTS), dtype=np.int64)
    loose = np.full(len(index), 4, dtype=np.uint8)
    kernels.rasterise_grid(points, cells, pack_camera(camera), limits, image, counts, loose)
    # A pixel without neighbours forms no triangle; it is drawn as a point.
    splats_points = not counts[0].any() and not (image[2] >= 0).any()
    is_point = loose == 4
    if splats_points or is_point.any():
        pixel, n_points = assign_pixels(cloud, camera)
        if not splats_points:
            pixel[~is_point] = -1
        kernels.splat_points(points, pixel, index, image)
        splats_points &= n_points > 0 and not is_point.all()
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
        is_point_splat=splats_points,
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


def _pack_membrane(membrane: Membrane) -> tuple[float, float, float, Doubles, int, int]:
    ny, nx = membrane.z_mm.shape
    corner = (float(membrane.x0_mm), float(membrane.y0_mm))
    return (
        *corner,
        float(1.0 / membrane.step_mm),
        flatten_read_only(membrane.z_mm, np.float64),
        nx,
        ny,
    )


def _measure_spacing_mm(cloud: Cloud) -> float:
    """Median distance of neighbouring points, 0 if none has a neighbour; of many only some."""
    from pipeline.stages.target_depth import projection_kernels as kernels

    points_mm = cloud.points_mm
    index = cloud.source_index
    if (index[1:] < index[:-1]).any():
        order = np.argsort(index, kind="stable")
        points_mm = points_mm[order]
        index = index[order]
    points_mm = flatten_read_only(points_mm)
    index = flatten_read_only(index, np.int32)
    lengths_mm = np.empty(_SPACING_SAMPLES)
    for every in (max(1, len(index) // _SPACING_SAMPLES), 1):
        n = kernels.measure_steps(points_mm, index, every, cloud.stride, MIN_DEPTH_MM, lengths_mm)
        if n:
            # np.median takes three times as long
            return float(np.sort(lengths_mm[:n])[[(n - 1) // 2, n // 2]].mean())
    return 0.0


_EMPTY = "the target depth is empty"
_NEXT_CORNER = [1, 2, 3, 0]  # next corner of a quadrilateral
_MANY = 0.05  # share of points outside the image from which on it is a warning


@frozen
class PointSplatParams:
    """The point splat has no parameters."""


@frozen
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
        rasterisation = rasterise_surface(
            cloud,
            target.camera,
            target.membrane,
            jump_mm=surface.jump_mm,
            grazing_deg=surface.grazing_deg,
        )
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
        drawing_notes = _note_shared_pixels(n_inside, rasterisation.n_drawn_px)
    else:
        drawing_notes = _note_omitted_triangles(
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
            *_note_visibility(rasterisation, n_inside, cloud.points_mm),
            *drawing_notes,
            *_note_contact(
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
        error=cloud.error,
    )


def skip_without_contact(
    cloud: Cloud,
    target: SensorSpec,
    params: ProjectionParams,  # noqa: ARG001 - a method's arguments
) -> TargetDepth | None:
    """The empty target depth if the cloud is empty, else None; same inputs as `project_cloud`."""
    if cloud.points_mm.shape[0] > 0:
        return None
    shape = target.camera.shape
    return TargetDepth(
        depth_mm=freeze(np.full(shape, np.nan, dtype=np.float32)),
        contact=freeze(np.zeros(shape, dtype=np.bool_)),
        indentation_mm=freeze(np.zeros(shape, dtype=np.float32)),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, dtype=np.int32)),
        in_view=_compute_field_of_view(cloud, target),
        notes=(describe_no_contact(_EMPTY, cloud.notes),),
        pixel_of_point=freeze(np.empty(0, dtype=np.int32)),
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


def _note_visibility(
    rasterisation: Rasterisation, n_inside: int, points_mm: Floats
) -> tuple[str, ...]:
    """How much of the touch is inside the target's image."""
    n = len(points_mm)
    n_outside = len(points_mm) - n_inside
    if n_outside == n:
        behind = bool((points_mm[:, 2] <= MIN_DEPTH_MM).all())
        where = (
            "behind the target's camera; check the rotation of the alignment"
            if behind
            else "outside the target's image"
        )
        return (AlignmentWarning(f"the target depth is empty: the whole touch lies {where}"),)
    text = f"{n_outside:,} of {n:,} points fall outside the target's image"
    notes: tuple[str, ...] = (
        (StageWarning(text) if n_outside > _MANY * n else text,) if n_outside else ()
    )
    if not rasterisation.n_drawn_px:
        notes += (
            StageWarning(
                "the target depth is empty: no part of the touch could be drawn; check the depth "
                "limits"
            ),
        )
    return notes


def _note_shared_pixels(n_inside: int, n_drawn: int) -> tuple[str, ...]:
    """Points that the splat lost to nearer ones."""
    if n_drawn == n_inside:
        return ()
    return (f"{n_inside - n_drawn:,} of {n_inside:,} points share a pixel with a nearer one",)


def _note_omitted_triangles(
    rasterisation: Rasterisation, jump_mm: float, grazing_deg: float, n_hidden: int
) -> tuple[str, ...]:
    """What the surface omits."""
    from pipeline.stages.target_depth import projection_kernels as kernels

    counts = rasterisation.triangle_counts
    jump, grazing, behind = (
        int(counts[k]) for k in (kernels.JUMP, kernels.GRAZING, kernels.BEHIND)
    )
    notes: list[str] = []
    if jump:
        notes.append(f"{jump:,} triangles across depth jumps above {jump_mm:g} mm were omitted")
    if grazing:
        hiding = (
            f" and hide what lies behind them in {rasterisation.n_veiled_px:,} pixels"
            if rasterisation.n_veiled_px
            else ""
        )
        notes.append(
            f"{grazing:,} triangles seen at more than {grazing_deg:g} degrees were omitted{hiding}"
        )
    if behind:
        notes.append(f"{behind:,} triangles reach behind the target's camera and were omitted")
    if counts[kernels.OVERFULL]:
        text = (
            f"the surface overlaps itself more than {kernels.MAX_LAYERS} times: "
            f"{int(counts[kernels.OVERFULL]):,} "
            "triangles were omitted; check the depth and the alignment"
        )
        notes.append(StageWarning(text))
    if counts[kernels.FLIPPED] > counts[kernels.DRAWN]:
        notes.append(
            StageWarning("the surface is seen from behind; check the rotation of the alignment")
        )
    if rasterisation.is_point_splat:
        notes.append("the touch is smaller than a target pixel: drawn as points")
    if n_hidden:
        notes.append(f"{n_hidden:,} points are hidden behind nearer ones")
    return tuple(notes)


def _note_contact(
    target: SensorSpec, *, n_drawn: int, n_contact: int, gap_mm: float, deepest_mm: float
) -> tuple[str, ...]:
    """Whether and how far the touch indents the target's membrane.

    `gap_mm` is the distance without contact.
    """
    if n_drawn == 0:
        return ()
    if n_contact == 0:
        text = (
            f"the touch ends {gap_mm:.2g} mm before the target's membrane: there is no "
            "contact; correct the alignment"
        )
        return (AlignmentWarning(text),)
    notes: list[str] = []
    if n_contact < n_drawn:
        notes.append(
            f"{n_drawn - n_contact:,} of {n_drawn:,} pixels do not reach the target's membrane"
        )
    if deepest_mm > target.limits.indentation_max_mm:
        limit_mm = target.limits.indentation_max_mm
        notes.append(
            StageWarning(
                f"pushed in by up to {deepest_mm:.2f} mm, beyond the {limit_mm:g} mm of "
                f"{target.name}"
            )
        )
    return tuple(notes)
