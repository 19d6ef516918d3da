"""Estimate how much the agreement changes when an alignment moves a little along each axis."""

from dataclasses import dataclass

import numpy as np

from pipeline.alignment.nudge import axis_unit, nudge
from pipeline.alignment.score import AlignmentScore, score_preview
from pipeline.alignment.target_observation import TargetObservation
from pipeline.alignment.touches import AlignmentTouch, find_pivot
from pipeline.base.arrays import Doubles
from pipeline.base.progress import SILENT, Progress
from pipeline.sensors.alignment import AXES, Alignment, Axis
from pipeline.stages.target_depth.surface_projection import ProjectionParams

UNIT_STEP = 0.1  # mm or deg: unit of all stated changes
_STEP_PX = 0.5  # masks change by whole pixels: smaller motions show nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreChange:
    """Change of one figure of the score along one axis, per 0.1 mm or 0.1 deg; None where unknown."""

    slope: float | None  # signed, toward the axis' positive direction
    magnitude: float | None  # mean |change| to both sides: how much the axis matters, also at the optimum


@dataclass(frozen=True, slots=True, kw_only=True)
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

    Moves by about half a pixel of that grid and states the change per 0.1 mm or 0.1 deg. Rotations are about `pivot`
    (3,) mm in the target frame, by default the contact's centroid.
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
            score_preview(touch, nudge(alignment, axis, amount, pivot_mm=about), observation, params)[1]
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


def _change(down: AlignmentScore, here: AlignmentScore, up: AlignmentScore, name: str, step: float) -> ScoreChange:
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
