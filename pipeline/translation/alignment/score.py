"""How well a touch transferred by an alignment agrees with the target's observation of it, and
how sensitively.

Prepare the target's side of a touch once: while a handle is dragged only the source's side is
computed.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import DepthMap, TargetDepth
from pipeline.sensors.alignment import AXES, Alignment, Axis
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.target_depth.surface_projection import (
    ProjectionParams,
    SurfaceProjectionParams,
    project_cloud,
)
from pipeline.translation.alignment.nudge import axis_unit, nudge
from pipeline.translation.alignment.touches import AlignmentTouch, find_pivot

PREVIEW_FACTOR = 4  # stride of pixels while a handle is dragged
_MIN_ROWS = 64  # smallest preview; a coarser image is fast at full size


@frozen
class TargetObservation:
    """The target's measurement of a touch, on the grid that the source's side is rendered into."""

    spec: SensorSpec  # the target with the camera of this grid
    factor: int  # pixels of the target per pixel here, along each side
    contact: Mask  # (rows, cols)
    depth_mm: Floats  # (rows, cols) target frame; NaN outside the contact
    edge: Mask  # (rows, cols) outermost pixels of the contact
    edge_distance_px: (
        # (rows, cols) distance to the nearest of them, in pixels of this grid; 0 everywhere if none
        Floats
    )


def observe_target(target: DepthMap, spec: SensorSpec, *, factor: int = 1) -> TargetObservation:
    """Reduce the target's depth map of a touch for `score`.

    `factor` 1 is full size, `PREVIEW_FACTOR` for dragging.

    The grid is that of the depth map's own camera. A pixel of a smaller grid is in contact where
    half of its area is. Raises SettingProblem for a factor below 1.
    """
    if factor < 1:
        raise SettingProblem(f"a preview takes every n-th pixel, with n at least 1, got {factor}")
    rendered = spec.with_camera(target.camera)
    if factor > 1:
        rendered = rendered.with_camera(rendered.camera.scale(1.0 / factor))
    contact, depth_mm = _resample(target, rendered.camera)
    edge = find_edge(contact)
    return TargetObservation(
        spec=rendered,
        factor=factor,
        contact=freeze(contact),
        depth_mm=freeze(depth_mm),
        edge=freeze(edge),
        edge_distance_px=freeze(compute_distance_px(edge)),
    )


def choose_preview_factor(spec: SensorSpec) -> int:
    """Return the factor for dragging: `PREVIEW_FACTOR`, less where the image would get too
    small.
    """
    return max(1, min(PREVIEW_FACTOR, min(spec.camera.shape) // _MIN_ROWS))


def find_edge(mask: Mask) -> Mask:
    """Return the pixels of a mask with a neighbour outside it.

    The border of the image is no edge.
    """
    import cv2

    return mask & (cv2.erode(mask.view(np.uint8), np.ones((3, 3), np.uint8)) == 0)


def compute_distance_px(edge: Mask) -> Floats:
    """Return each pixel's distance (rows, cols) to the nearest of `edge`.

    0 everywhere where there is none.
    """
    import cv2

    if not edge.any():
        return np.zeros(edge.shape, np.float32)
    return np.asarray(
        cv2.distanceTransform((~edge).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5), np.float32
    )


def _resample(target: DepthMap, camera: Camera) -> tuple[Mask, Floats]:
    """Return contact and depth on the grid of `camera`: area shares, and means over the contact."""
    import cv2

    usable = target.contact & np.isfinite(target.depth_mm)
    depth_mm = np.where(usable, target.depth_mm, np.float32(0.0))
    if camera.shape == target.camera.shape:
        return target.contact.copy(), np.where(usable, depth_mm, np.float32(np.nan))
    size = (camera.cols, camera.rows)
    contact_share, share, depth_mm = (
        np.asarray(cv2.resize(a.astype(np.float32), size, interpolation=cv2.INTER_AREA))
        for a in (target.contact, usable, depth_mm)
    )
    contact = contact_share >= 0.5
    mean = np.divide(
        depth_mm, share, out=np.full(share.shape, np.nan, np.float32), where=contact & (share > 0)
    )
    return contact, mean


@frozen
class AlignmentScore:
    """Agreement within the source's field of view; None where there is nothing to compare."""

    iou: float  # of the contact masks; 1 where both are empty
    # mean distance of the outlines, both ways, in pixels of the target's full image
    edge_px: float | None
    depth_mm: float | None  # median |difference| of depth where both are in contact
    depth_rms_mm: float | None
    # median of transferred - observed; positive = too far from the target's camera
    bias_mm: float | None
    overlap_px: int  # pixels of the scored grid in contact on both sides


def score_alignment(view: TargetDepth, observation: TargetObservation) -> AlignmentScore:
    """Compare a target depth rendered into `observation.spec` with the observation.

    Outlines at the border of either sensor's image are cut off and left out.
    """
    there = observation.contact & view.in_view
    both = view.contact & there
    either = int(np.count_nonzero(view.contact | there))
    overlap = int(np.count_nonzero(both))
    gap = (view.depth_mm[both] - observation.depth_mm[both]).astype(np.float64)
    gap = gap[np.isfinite(gap)]
    return AlignmentScore(
        iou=overlap / either if either else 1.0,
        edge_px=_edge_px(view, observation),
        depth_mm=float(np.median(np.abs(gap))) if gap.size else None,
        depth_rms_mm=float(np.sqrt(np.mean(gap * gap))) if gap.size else None,
        bias_mm=float(np.median(gap)) if gap.size else None,
        overlap_px=overlap,
    )


def score_preview(
    touch: AlignmentTouch,
    alignment: Alignment,
    observation: TargetObservation,
    params: ProjectionParams | None = None,
) -> tuple[TargetDepth, AlignmentScore]:
    """Render the touch under the alignment on the observation's grid, and score it."""
    aligned = touch.apply_instance_shifts(alignment)
    drawn = params or SurfaceProjectionParams()
    cloud = back_project_depth(
        touch.source, aligned, BackProjectionParams(stride=_stride(touch, observation))
    )
    view = project_cloud(cloud, observation.spec, drawn)
    return view, score_alignment(view, observation)


def score_touches(
    touches: Sequence[AlignmentTouch],
    observations: Sequence[TargetObservation],
    alignment: Alignment,
    progress: Progress = SILENT,
) -> tuple[AlignmentScore, ...]:
    """Score every touch; shows what one frame gains at the cost of the others."""
    found: list[AlignmentScore] = []
    for done, (touch, side) in enumerate(zip(touches, observations, strict=True)):
        progress.step(done / len(touches), f"scoring frame {touch.index}")
        found.append(score_preview(touch, alignment, side)[1])
    return tuple(found)


def median_score(found: Sequence[AlignmentScore]) -> AlignmentScore | None:
    """Return medians over the frames that have a value; None without frames."""
    if not found:
        return None

    def middle(name: str) -> float | None:
        values = [value for s in found if (value := getattr(s, name)) is not None]
        return float(np.median(values)) if values else None

    return AlignmentScore(
        iou=float(np.median([s.iou for s in found])),
        edge_px=middle("edge_px"),
        depth_mm=middle("depth_mm"),
        depth_rms_mm=middle("depth_rms_mm"),
        bias_mm=middle("bias_mm"),
        overlap_px=int(np.median([s.overlap_px for s in found])),
    )


def _stride(touch: AlignmentTouch, observation: TargetObservation) -> int:
    """Return a stride of source pixels: at most the observation's factor, no sparser than its
    pixels.
    """
    camera = touch.source.camera
    depth = touch.source.depth_mm[::16, ::16]
    seen = depth[np.isfinite(depth)]
    if observation.factor == 1 or not seen.size:
        return 1
    pixel_mm = float(np.median(seen)) / camera.fx_px
    return int(np.clip(observation.spec.pixel_mm / pixel_mm, 1, observation.factor))


def _edge_px(view: TargetDepth, observation: TargetObservation) -> float | None:
    inside = _inside(view.in_view)
    drawn = find_edge(view.contact) & inside
    there = observation.edge & inside
    if not drawn.any() or not there.any():
        return None
    onward = float(observation.edge_distance_px[drawn].mean())
    back = float(compute_distance_px(drawn)[there].mean())
    return 0.5 * (onward + back) * observation.factor


def _inside(known: Mask) -> Mask:
    """Return the mask without its outermost two pixels, where a touch is cut off."""
    import cv2

    return cv2.erode(known.view(np.uint8), np.ones((5, 5), np.uint8)).view(np.bool_)


UNIT_STEP = 0.1  # mm or deg: unit of all stated changes
_STEP_PX = 0.5  # masks change by whole pixels: smaller motions show nothing


@frozen
class ScoreChange:
    """Change of one figure of the score along one axis, per 0.1 mm or 0.1 deg.

    None where unknown.
    """

    slope: float | None  # signed, toward the axis' positive direction
    # mean |change| to both sides: how much the axis matters, also at the optimum
    magnitude: float | None


@frozen
class Sensitivity:
    """One axis."""

    axis: Axis
    unit: str  # mm or deg
    step: float  # motion to either side
    iou: ScoreChange
    edge_px: ScoreChange
    depth_mm: ScoreChange  # of the rms difference, which is smooth


def compute_sensitivities(
    touch: AlignmentTouch,
    alignment: Alignment,
    observation: TargetObservation,
    params: ProjectionParams | None = None,
    *,
    pivot: Doubles | None = None,
    progress: Progress = SILENT,
) -> tuple[Sensitivity, ...]:
    """Estimate the six axes by differences of thirteen previews on the grid of `observation`.

    Moves by about half a pixel of that grid and states the change per 0.1 mm or 0.1 deg. Rotations
    are about `pivot` (3,) mm in the target frame, by default the contact's centroid.
    """
    about = find_pivot(touch, alignment) if pivot is None else pivot
    here = score_preview(touch, alignment, observation, params)[1]
    shift_mm = max(UNIT_STEP, _STEP_PX * observation.spec.pixel_mm)
    turn_deg = max(UNIT_STEP, float(np.rad2deg(shift_mm / _radius_mm(touch))))
    score: list[Sensitivity] = []
    for done, axis in enumerate(AXES):
        progress.step(done / len(AXES), f"moving along {axis}")
        step = turn_deg if axis_unit(axis) == "deg" else shift_mm
        down, up = (
            score_preview(
                touch, nudge(alignment, axis, amount, pivot_mm=about), observation, params
            )[1]
            for amount in (-step, step)
        )
        score.append(
            Sensitivity(
                axis=axis,
                unit=axis_unit(axis),
                step=step,
                iou=_change(down, here, up, "iou", step),
                edge_px=_change(down, here, up, "edge_px", step),
                depth_mm=_change(down, here, up, "depth_rms_mm", step),
            )
        )
    return tuple(score)


def _change(
    down: AlignmentScore, here: AlignmentScore, up: AlignmentScore, name: str, step: float
) -> ScoreChange:
    a, b, c = (getattr(s, name) for s in (down, here, up))
    per = UNIT_STEP / step
    slope = None if a is None or c is None else 0.5 * (c - a) * per
    sides = [abs(side - b) for side in (a, c) if side is not None] if b is not None else []
    return ScoreChange(slope=slope, magnitude=per * sum(sides) / len(sides) if sides else None)


def _radius_mm(touch: AlignmentTouch) -> float:
    """Return the contact's root mean square radius, at least a millimetre."""
    row, col = np.nonzero(touch.source.contact)
    if not row.size:
        return 1.0
    camera = touch.source.camera
    z = float(np.nanmedian(touch.source.depth_mm))
    spread = np.hypot(np.std(col) * z / camera.fx_px, np.std(row) * z / camera.fy_px)
    return max(float(spread), 1.0)
