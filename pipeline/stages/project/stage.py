"""Projection: the cloud as the target sensor's camera sees it (paper, eqs. D_T'' and M_T'').

`mode="paper"` is the point splat of the equations. `mode="surface"` draws the source pixel grid as triangles instead,
with 1/Z interpolated linearly in screen space: no holes, and hundreds of times less error (benchmarks/reprojection.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, assert_never

import numpy as np

from pipeline.base.arrays import Floats, Mask, for_geometry, freeze
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry.camera import MIN_DEPTH_MM, Camera
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.project import sight_notes
from pipeline.stages.project.drawing import Drawing, Rest, rasterised, splatted
from pipeline.values.results import Cloud, TargetView

Mode = Literal["surface", "paper"]

NO_CONTACT = "no contact: the target sees nothing"
SAME_SURFACE_MM = 0.2  # a point this close behind what its pixel shows is part of it, not hidden by it
_FINER = 4  # pixels along each side of one, where its coverage is asked for


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectParams:
    """How the cloud is drawn."""

    mode: Mode = setting(
        "surface",
        "Projection",
        choices=Mode,
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
    coverage: bool = setting(
        False, "Sub-pixel coverage", help="also say how much of each target pixel is in contact, in sixteenths"
    )


def project(cloud: Cloud, target: SensorSpec, params: ProjectParams, progress: Progress = SILENT) -> TargetView:
    """Depth, contact mask and indentation (rows, cols) in the target camera; the nearest surface wins each pixel.

    The mask is the test SDF(p, M_target) <= 0 on the target's rest surface as a height field, whose sign is exact: on
    every point in paper mode, on what each pixel sees in surface mode. `pixel_of_point` is -1 for a point more than
    SAME_SURFACE_MM behind what its pixel and the eight around it show. Raises ShapeError when the cloud is not sound.
    """
    empty = without_contact(cloud, target, params)
    if empty is not None:
        return empty
    _check(cloud, params)
    progress.step(0.0, "drawing the touch in the target image")
    view = view_of(replace(cloud, points_mm=for_geometry(cloud.points_mm)), target, params)
    progress.step(1.0, "drawn")
    return view


def view_of(cloud: Cloud, target: SensorSpec, params: ProjectParams) -> TargetView:
    """As `project`, of a cloud that is sound and has a point."""
    from pipeline.stages.project import project_kernels as kernels

    rest = _rest(target)
    if params.mode == "paper":
        drawing = splatted(cloud.points_mm, cloud.source_index, target.camera, rest)
    elif params.mode == "surface":
        drawing = _surface(cloud, target.camera, rest, params)
    else:
        assert_never(params.mode)
    shape = target.camera.shape
    indentation = np.empty(drawing.depth_mm.size, dtype=np.float32)
    n_contact, deepest_mm = kernels.push_in(
        drawing.depth_mm, drawing.contact, target.rest_depth_mm.reshape(-1), indentation
    )
    arrived = sight_notes.arrival(drawing, cloud.points_mm)
    short_mm = 0.0 if n_contact else _short_mm(cloud, drawing, target, params)
    _, n_hidden = kernels.hide(cloud.points_mm, drawing.depth_mm, shape, SAME_SURFACE_MM, drawing.pixel)
    return TargetView(
        depth_mm=freeze(drawing.depth_mm.reshape(shape)),
        contact=freeze(drawing.contact.reshape(shape)),
        indentation_mm=freeze(indentation.reshape(shape)),
        camera=target.camera,
        source_index=freeze(drawing.source.reshape(shape)),
        known=_known(cloud, target),
        notes=(
            *arrived,
            *_drawing_notes(drawing, params, int(n_hidden)),
            *sight_notes.reach(
                target, n_drawn=drawing.n_drawn, n_contact=int(n_contact), short_mm=short_mm,
                deepest_mm=float(deepest_mm),
            ),
        ),
        pixel_of_point=freeze(drawing.pixel),
        coverage=_coverage(cloud, target, params) if params.coverage else None,
    )  # fmt: skip


def without_contact(cloud: Cloud, target: SensorSpec, params: ProjectParams) -> TargetView | None:
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
        pixel_of_point=freeze(np.empty(0, dtype=np.int32)),
        coverage=freeze(np.zeros(shape, dtype=np.float32)) if params.coverage else None,
    )


def _known(cloud: Cloud, target: SensorSpec) -> Mask:
    """The target pixels inside the source's window; none of them when the window reaches behind the camera."""
    from pipeline.stages.project import project_kernels as kernels

    known = np.zeros(target.camera.shape, dtype=np.bool_)
    if (cloud.window_mm[:, 2] > MIN_DEPTH_MM).all():
        x_px, y_px, _ = target.camera.project(cloud.window_mm)
        kernels.fill_window(x_px, y_px, known)
    return freeze(known)


def _check(cloud: Cloud, params: ProjectParams) -> None:
    n, (rows, cols) = cloud.points_mm.shape[0], cloud.grid_shape
    if cloud.points_mm.shape != (n, 3) or cloud.source_index.shape != (n,):
        raise ShapeError(
            f"a cloud needs points (n, 3) and one source_index each, "
            f"got {cloud.points_mm.shape} and {cloud.source_index.shape}"
        )
    if cloud.source_index.min() < 0 or cloud.source_index.max() >= rows * cols:
        raise ShapeError(f"source_index of the cloud points outside its grid of {rows} x {cols} pixels")
    check_mode(params)


def check_mode(params: ProjectParams) -> None:
    """Raises SettingProblem for a mode that does not exist."""
    if params.mode not in ("surface", "paper"):
        raise SettingProblem(f"project.mode must be 'surface' or 'paper', got {params.mode!r}")


def _rest(target: SensorSpec) -> Rest:
    surface = target.membrane
    return Rest(x0_mm=surface.x0_mm, y0_mm=surface.y0_mm, per_mm=1.0 / surface.step_mm, z_mm=surface.z_mm)


def _short_mm(cloud: Cloud, drawing: Drawing, target: SensorSpec, params: ProjectParams) -> float:
    """The smallest signed distance to the membrane, of the points in view or of what the pixels see."""
    if params.mode == "paper":
        seen = cloud.points_mm[drawing.pixel >= 0]
    else:
        row, col = np.nonzero(drawing.source.reshape(target.camera.shape) >= 0)
        (ray_x, ray_y), z = target.camera.rays(), drawing.depth_mm[drawing.source >= 0].astype(np.float64)
        seen = np.stack([z * ray_x[col], z * ray_y[row], z], axis=-1)
    return float(target.membrane.signed_distance_mm(seen).min(initial=np.inf))


def _drawing_notes(drawing: Drawing, params: ProjectParams, n_hidden: int) -> tuple[str, ...]:
    if params.mode == "paper":
        return sight_notes.points(drawing)
    return sight_notes.triangles(drawing, params.jump_mm, params.grazing_deg, n_hidden)


def _surface(cloud: Cloud, camera: Camera, rest: Rest, params: ProjectParams) -> Drawing:
    limits = (params.jump_mm, params.grazing_deg)
    return rasterised(cloud.points_mm, cloud.source_index, cloud.grid_shape, cloud.stride, camera, rest, limits)


def _coverage(cloud: Cloud, target: SensorSpec, params: ProjectParams) -> Floats:
    """Share of each pixel (rows, cols) that the surface covers in contact: drawn again with 4 x 4 pixels in each."""
    (rows, cols), fine = target.camera.shape, target.camera.scaled(_FINER)
    contact = _surface(cloud, fine, _rest(target), params).contact
    return freeze(contact.reshape(rows, _FINER, cols, _FINER).mean(axis=(1, 3), dtype=np.float32))
