"""Back-projection of contact pixels to points in the target frame (paper, depth adaptation
stage, eq. P_T).
"""

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Indices, ensure_float, freeze
from pipeline.core.errors import ShapeError, describe_no_contact
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import MIN_DEPTH_MM
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import Cloud, DepthMap
from pipeline.sensors.alignment import Alignment

_EMPTY = "the cloud is empty"
MAX_DEPTH_MM = 1e9  # depths beyond are ignored for the median depth


@frozen
class BackProjectionParams:
    """Density of the cloud."""

    stride: int = setting(
        1,
        "Every n-th pixel",
        unit="px",
        low=1,
        high=16,
        step=1,
        help="use every n-th row and column; more than 1 is a faster, coarser preview",
        source="the paper, eq. P_T",
    )


def back_project_depth(
    depth: DepthMap, alignment: Alignment, params: BackProjectionParams, progress: Progress = SILENT
) -> Cloud:
    """Contact points (n, 3) in the target frame, mm, in the order of their pixels.

    P_T = { T_S->T (D_S'(u,v) K_S^-1 (u, v, 1)^T) : M_S'(u,v) = 1 }, computed in float64 and rounded
    to float32 once. Where the depth map has an object surface, it replaces the membrane, and pixels
    outside the contact are included. Raises ShapeError when the arrays do not fit the camera,
    CalibrationError when the alignment is not rigid.
    """
    progress.step(0.0, "transforming contact pixels to the target frame")
    if depth.depth_mm.shape != depth.camera.shape or depth.contact.shape != depth.camera.shape:
        raise ShapeError(
            f"depth_mm and contact must have the shape {depth.camera.shape} of their camera, "
            f"got {depth.depth_mm.shape} and {depth.contact.shape}"
        )
    target_from_source = rigid.validate_rigid(alignment.target_from_source, "the alignment T_S->T")
    points, pixel, n_contact = _compute_points(depth, target_from_source, params.stride)
    progress.step(1.0, "transformed")
    return Cloud(
        points_mm=freeze(points),
        source_index=freeze(pixel),
        field_of_view_mm=_compute_window(depth, target_from_source),
        grid_shape=depth.camera.shape,
        stride=params.stride,
        notes=_make_notes(
            depth.notes, n_contact=n_contact, n_points=pixel.size, stride=params.stride
        ),
        error=depth.error,
    )


def skip_without_contact(
    depth: DepthMap, alignment: Alignment, params: BackProjectionParams
) -> Cloud | None:
    """The empty cloud if no pixel is in contact, else None; same inputs as `back_project_depth`."""
    if depth.contact.any():
        return None
    return Cloud(
        points_mm=freeze(np.empty((0, 3), dtype=np.float32)),
        source_index=freeze(np.empty(0, dtype=np.int32)),
        field_of_view_mm=_compute_window(depth, alignment.target_from_source),
        grid_shape=depth.camera.shape,
        stride=params.stride,
        notes=(describe_no_contact(_EMPTY, depth.notes),),
    )


def _compute_points(
    depth: DepthMap, target_from_source: Doubles, stride: int
) -> tuple[Floats, Indices, int]:
    """Points z (R (x/z, y/z, 1)) + t (n, 3), their flat pixels (n,), and the number of contact
    pixels visited.

    K^-1 is applied as the ray of a row and a column.
    """
    from pipeline.stages.cloud import back_projection_kernels as kernels

    surface_mm = depth.depth_mm if depth.object_depth_mm is None else depth.object_depth_mm
    # A read-only view: writable and read-only arrays would be compiled separately.
    contact = freeze(
        np.ascontiguousarray(
            depth.contact if depth.object_depth_mm is None else np.isfinite(depth.object_depth_mm)
        ).view()
    )
    capacity = int(np.count_nonzero(contact[::stride, ::stride]))
    # one spare: a point is written before it is tested
    points = np.empty((capacity + 1, 3), dtype=np.float32)
    pixel = np.empty(capacity + 1, dtype=np.int32)
    columns = np.empty(contact.shape[1] + 1, dtype=np.int32)
    ray_x, ray_y = depth.camera.rays()
    depth_mm = np.ascontiguousarray(ensure_float(surface_mm))
    n, n_contact = kernels.back_project(
        depth_mm,
        contact,
        stride,
        ray_x,
        ray_y,
        target_from_source[:3],
        MIN_DEPTH_MM,
        columns,
        points,
        pixel,
    )
    return points[:n], pixel[:n], int(n_contact)


def _compute_window(depth: DepthMap, target_from_source: Doubles) -> Floats:
    """Corners (4, 3) of the source image on a plane at its median depth, in the target frame."""
    camera = depth.camera
    z = _compute_median_depth(depth.depth_mm[::16, ::16]) or _compute_median_depth(depth.depth_mm)
    x = (np.array([-0.5, camera.cols - 0.5, camera.cols - 0.5, -0.5]) - camera.cx_px) / camera.fx_px
    y = (np.array([-0.5, -0.5, camera.rows - 0.5, camera.rows - 0.5]) - camera.cy_px) / camera.fy_px
    return freeze(
        rigid.apply(target_from_source, np.stack([z * x, z * y, z * np.ones(4)], axis=-1)).astype(
            np.float32
        )
    )


def _compute_median_depth(depth_mm: Floats) -> float:
    """Median of the valid depths, 0 if there are none."""
    valid = depth_mm[(depth_mm > MIN_DEPTH_MM) & (depth_mm < MAX_DEPTH_MM)]
    return float(np.median(valid)) if valid.size else 0.0


def _make_notes(
    depth_notes: tuple[str, ...], *, n_contact: int, n_points: int, stride: int
) -> tuple[str, ...]:
    notes: list[str] = []
    if n_contact == 0:
        notes.append(
            describe_no_contact(_EMPTY, depth_notes)
            if stride == 1
            else f"no contact pixel in every {stride}th row and column; lower the stride"
        )
    elif n_points < n_contact:
        notes.append(
            f"{n_contact - n_points:,} of {n_contact:,} contact pixels have no depth and were "
            "left out"
        )
    if stride > 1 and n_points:
        notes.append(f"preview: every {stride}th row and column")
    return tuple(notes)
