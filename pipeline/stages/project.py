"""Projection: the cloud as the target sensor's camera sees it (paper, eqs. D_T'' and M_T'').

`mode="paper"` is the point splat of the equations. `mode="surface"` draws the source pixel grid as triangles instead,
with 1/Z interpolated linearly in screen space: no holes, and hundreds of times less error (benchmarks/reprojection.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Doubles, Indices, Mask, freeze
from pipeline.camera import MIN_DEPTH_MM, Camera
from pipeline.errors import SettingProblem, ShapeError
from pipeline.params import setting
from pipeline.progress import SILENT, Progress
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.results import Cloud, TargetView

NO_CONTACT = "no contact: the target sees nothing"
_SPACING_SAMPLES = 2000  # neighbours looked at to learn how far apart source pixels are


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectParams:
    """How the cloud is drawn."""

    mode: str = setting(
        "surface",
        "Projection",
        choices=("surface", "paper"),
        help="surface: triangles between neighbouring pixels; paper: single points, as in the equations",
    )
    jump_mm: float = setting(
        1.0, "Depth jump", unit="mm", low=0.01, high=50.0, step=0.1,
        help="neighbours farther apart than this, beyond their usual spacing, are an edge and not joined",
    )  # fmt: skip
    grazing_deg: float = setting(
        84.0, "Grazing limit", unit="deg", low=1.0, high=90.0, step=1.0,
        help="triangles seen at a flatter angle than this from their normal are left out",
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Drawing:
    """What the loops saw: z of every target pixel (0 = nothing), the point behind it, and each point's own pixel."""

    depth_mm: Doubles  # (rows * cols,) 0 = nothing there
    source: Indices  # (rows * cols,)
    pixel: Indices  # (n,) of each point, -1 = not in the image
    notes: tuple[str, ...] = ()


def project(cloud: Cloud, target: SensorSpec, params: ProjectParams, progress: Progress = SILENT) -> TargetView:
    """Depth, contact mask and indentation (rows, cols) in the target camera; the nearest surface wins each pixel.

    The mask is the test SDF(p, M_target) <= 0 on the target's rest surface as a height field, whose sign is exact: on
    every point in paper mode, on what each pixel sees in surface mode. Raises ShapeError when the cloud is not sound.
    """
    empty = without_contact(cloud, target, params)
    if empty is not None:
        return empty
    _check(cloud, params)
    progress.step(0.0, "drawing the touch in the target image")
    drawing = _splatted(cloud, target.camera) if params.mode == "paper" else _rasterised(cloud, target.camera, params)
    progress.step(0.7, "testing against the target's membrane")
    seen = drawing.source >= 0
    shape = target.camera.shape
    contact, reach_mm = _membrane_test(cloud, target, drawing, per_point=params.mode == "paper")
    depth = np.where(seen, drawing.depth_mm, np.nan).reshape(shape)
    indentation = np.where(contact, np.maximum(target.rest_depth_mm - depth, 0.0), 0.0)
    progress.step(1.0, "drawn")
    return TargetView(
        depth_mm=freeze(depth.astype(np.float32)),
        contact=freeze(contact),
        indentation_mm=freeze(indentation.astype(np.float32)),
        camera=target.camera,
        source_index=freeze(drawing.source.reshape(shape)),
        known=_known(cloud, target),
        notes=(
            *_sight_notes(cloud, drawing),
            *drawing.notes,
            *_touch_notes(target, n_seen=int(seen.sum()), contact=contact, reach_mm=reach_mm, indentation=indentation),
        ),
    )


def without_contact(cloud: Cloud, target: SensorSpec, params: ProjectParams) -> TargetView | None:  # noqa: ARG001
    """The view of nothing when the cloud is empty, else None; same inputs as `project`."""
    if cloud.points_mm.shape[0] > 0:
        return None
    shape = target.camera.shape
    return TargetView(
        depth_mm=freeze(np.full(shape, np.nan, dtype=np.float32)),
        contact=freeze(np.zeros(shape, dtype=np.bool_)),
        indentation_mm=freeze(np.zeros(shape, dtype=np.float32)),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, dtype=np.int32)),
        known=_known(cloud, target),
        notes=(NO_CONTACT,),
    )


def _known(cloud: Cloud, target: SensorSpec) -> Mask:
    """The target pixels inside the source's window; none of them when the window reaches behind the camera."""
    import cv2

    known = np.zeros(target.camera.shape, np.uint8)
    if (cloud.window_mm[:, 2] > MIN_DEPTH_MM).all():
        x_px, y_px, _ = target.camera.project(cloud.window_mm)
        corners = np.clip(np.stack([x_px, y_px], axis=-1), -30_000, 30_000)  # OpenCV draws in 16 bits
        cv2.fillConvexPoly(known, np.rint(corners).astype(np.int32), 1)
    return freeze(known.astype(np.bool_))


def _check(cloud: Cloud, params: ProjectParams) -> None:
    n, (rows, cols) = cloud.points_mm.shape[0], cloud.grid_shape
    if cloud.points_mm.shape != (n, 3) or cloud.source_index.shape != (n,):
        raise ShapeError(
            f"a cloud needs points (n, 3) and one source_index each, "
            f"got {cloud.points_mm.shape} and {cloud.source_index.shape}"
        )
    if cloud.source_index.min() < 0 or cloud.source_index.max() >= rows * cols:
        raise ShapeError(f"source_index of the cloud points outside its grid of {rows} x {cols} pixels")
    if params.mode not in ("surface", "paper"):
        raise SettingProblem(f"project.mode must be 'surface' or 'paper', got {params.mode!r}")


def _on_screen(cloud: Cloud, camera: Camera) -> tuple[Doubles, Indices]:
    from pipeline.stages import project_kernels as kernels

    return kernels.to_screen(
        cloud.points_mm, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, camera.rows, camera.cols, MIN_DEPTH_MM
    )


def _splatted(cloud: Cloud, camera: Camera) -> _Drawing:
    from pipeline.stages import project_kernels as kernels

    screen, pixel = _on_screen(cloud, camera)
    inverse_z, source = _blank(camera)
    kernels.splat(screen, pixel, np.ones(pixel.size, dtype=np.bool_), cloud.source_index, inverse_z, source)
    n_inside, n_won = int((pixel >= 0).sum()), int((source >= 0).sum())
    notes = (
        (f"{n_inside - n_won:,} of {n_inside:,} points share a pixel with a nearer one",) if n_won < n_inside else ()
    )
    return _Drawing(depth_mm=_depth(inverse_z), source=source, pixel=pixel, notes=notes)


def _rasterised(cloud: Cloud, camera: Camera, params: ProjectParams) -> _Drawing:
    from pipeline.stages import project_kernels as kernels

    screen, pixel = _on_screen(cloud, camera)
    inverse_z, source = _blank(camera)
    grid = np.full(cloud.grid_shape, -1, dtype=np.int32)
    grid.ravel()[cloud.source_index] = np.arange(pixel.size, dtype=np.int32)
    in_triangle = np.zeros(pixel.size, dtype=np.bool_)
    counts = np.zeros(5, dtype=np.int64)
    max_edge_mm = params.jump_mm + _spacing_mm(cloud, grid, screen[:, 2] > 0)
    kernels.rasterise(
        cloud.points_mm, screen, grid, cloud.stride, max_edge_mm,
        math.cos(math.radians(params.grazing_deg)), inverse_z, source, in_triangle, camera.shape, counts,
    )  # fmt: skip
    # A pixel without neighbours spans no triangle; it is kept as the point that it is.
    alone = ~in_triangle
    notes = _triangle_notes(counts, params)
    if not (source >= 0).any() and (pixel >= 0).any() and not counts[: kernels.FLIPPED].any():
        alone = np.ones_like(alone)
        notes += ("the touch is smaller than a target pixel: drawn as points",)
    if alone.any():
        kernels.splat(screen, pixel, alone, cloud.source_index, inverse_z, source)
    depth_mm = _depth(inverse_z)
    inside = pixel >= 0
    in_front = depth_mm[pixel[inside]]
    n_hidden = int(((in_front > 0) & (cloud.points_mm[inside, 2] > in_front + max_edge_mm)).sum())
    if n_hidden:
        notes += (f"{n_hidden:,} points hide behind nearer ones",)
    return _Drawing(depth_mm=depth_mm, source=source, pixel=pixel, notes=notes)


def _blank(camera: Camera) -> tuple[Doubles, Indices]:
    n = camera.rows * camera.cols
    return np.zeros(n, dtype=np.float64), np.full(n, -1, dtype=np.int32)


def _depth(inverse_z: Doubles) -> Doubles:
    return np.divide(1.0, inverse_z, out=np.zeros_like(inverse_z), where=inverse_z > 0)


def _spacing_mm(cloud: Cloud, grid: Indices, drawable: Mask) -> float:
    """Twice the usual distance of neighbouring points: a diagonal, on a slope."""
    n = cloud.stride
    left, right = grid[::n, :-n:n].ravel(), grid[::n, n::n].ravel()
    pairs = np.flatnonzero((left >= 0) & (right >= 0))
    pairs = pairs[:: max(1, pairs.size // _SPACING_SAMPLES)]
    pairs = pairs[drawable[left[pairs]] & drawable[right[pairs]]]
    if pairs.size == 0:
        return 0.0
    a, b = (cloud.points_mm[side[pairs]].astype(np.float64) for side in (left, right))
    return 2.0 * float(np.median(np.linalg.norm(a - b, axis=1)))


def _membrane_test(cloud: Cloud, target: SensorSpec, drawing: _Drawing, *, per_point: bool) -> tuple[Mask, float]:
    """Contact (rows, cols), and the smallest signed distance to the membrane (inf when nothing is in the image)."""
    if per_point:
        index = np.flatnonzero(drawing.pixel >= 0)
        points, pixel = cloud.points_mm[index].astype(np.float64), drawing.pixel[index]
    else:
        pixel = np.flatnonzero(drawing.source >= 0)
        row, col = np.divmod(pixel, target.camera.cols)
        (ray_x, ray_y), z = target.camera.rays(), drawing.depth_mm[pixel]
        points = np.stack([z * ray_x[col], z * ray_y[row], z], axis=-1)
    distance_mm = target.membrane.signed_distance_mm(points)
    contact = np.zeros(target.camera.rows * target.camera.cols, dtype=np.bool_)
    contact[pixel[distance_mm <= 0.0]] = True
    return contact.reshape(target.camera.shape), float(distance_mm.min(initial=np.inf))


def _sight_notes(cloud: Cloud, drawing: _Drawing) -> tuple[str, ...]:
    n, inside = drawing.pixel.size, drawing.pixel >= 0
    n_outside = n - int(inside.sum())
    if n_outside == n:
        behind = bool((cloud.points_mm[:, 2] <= MIN_DEPTH_MM).all())
        where = "behind the target's camera; turn the alignment round" if behind else "outside the target's image"
        return (f"nothing arrives: the whole touch lies {where}",)
    notes = (f"{n_outside:,} of {n:,} points fall outside the target's image",) if n_outside else ()
    if not (drawing.source >= 0).any():
        notes += ("nothing arrives: no part of the touch could be drawn",)
    return notes


def _triangle_notes(counts: NDArray[np.int64], params: ProjectParams) -> tuple[str, ...]:
    from pipeline.stages import project_kernels as kernels

    jump, grazing, behind = (int(counts[k]) for k in (kernels.JUMP, kernels.GRAZING, kernels.BEHIND))
    flipped, kept = int(counts[kernels.FLIPPED]), int(counts[kernels.KEPT])
    notes: list[str] = []
    if jump:
        notes.append(f"{jump:,} triangles over depth jumps above {params.jump_mm:g} mm were left out")
    if grazing:
        notes.append(f"{grazing:,} triangles seen at more than {params.grazing_deg:g} degrees were left out")
    if behind:
        notes.append(f"{behind:,} triangles reach behind the target's camera and were left out")
    if flipped > kept:
        notes.append("the touch is seen from behind; check the rotation of the alignment")
    return tuple(notes)


def _touch_notes(
    target: SensorSpec, *, n_seen: int, contact: Mask, reach_mm: float, indentation: Doubles
) -> tuple[str, ...]:
    n_contact = int(contact.sum())
    if n_seen == 0:
        return ()
    if n_contact == 0:
        return (
            f"the touch does not reach the target's membrane by {reach_mm:.2g} mm; move it closer in the alignment",
        )
    notes: list[str] = []
    if n_contact < n_seen:
        notes.append(f"{n_seen - n_contact:,} of {n_seen:,} pixels do not reach the target's membrane")
    deepest = float(indentation.max())
    if deepest > target.limits.indentation_max_mm:
        notes.append(
            f"pushed in by up to {deepest:.2f} mm, beyond the {target.limits.indentation_max_mm:g} mm of {target.name}"
        )
    return tuple(notes)
