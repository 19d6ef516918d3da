"""How far a result is from what is known to be true."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Mask
from pipeline.engine.graph import StageResult
from pipeline.evaluation.symmetric import ambiguity, symmetric_error
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.values.frames import TactileFrame, Truth
from pipeline.values.results import DepthMap, ObjectPose, Touch

if TYPE_CHECKING:
    from pipeline.geometry.symmetry import Symmetry

_SAME_MM = 1.0  # answers this close are one
PSNR_CAP_DB = 100.0  # identical images have no finite ratio; published tables cap it too


def frame_metrics(
    results: Mapping[str, StageResult],
    source: Truth | None,
    target: tuple[TactileFrame, Truth | None] | None,
    mesh: Mesh | None = None,
    symmetry: Symmetry | None = None,
) -> dict[str, float]:
    """Every figure that the known truth allows for one frame; an empty dictionary where nothing is known.

    `mesh` and its `symmetry` (None = not known, taken as none) are those of the object that the true pose is about.
    `pose.translation_mm` and `pose.rotation_deg` are plain; `pose.mssd_mm`, `pose.se2_mm`, `pose.se2_deg`,
    `pose.observable_mm` and `pose.observable_deg` are those of `SymmetricError`; `pose.answers` counts the poses that
    fit equally well, up to symmetry, `pose.answers_apart_mm` is the largest MSSD between two of them.
    """
    figures: dict[str, float] = {}
    depth = results["depth"].output if "depth" in results else None
    if isinstance(depth, DepthMap) and source is not None:
        figures.update(_surface("depth", depth.indentation_mm, depth.contact, source))
    touch = results["generate"].output if "generate" in results else None
    if isinstance(touch, Touch) and target is not None:
        frame, known = target
        figures.update(_picture(touch, frame))
        if known is not None:
            figures.update(_surface("generate", touch.indentation_mm, touch.contact, known))
    pose = results["pose"].output if "pose" in results else None
    if isinstance(pose, ObjectPose) and target is not None and target[1] is not None:
        figures.update(_pose(pose, target[1], mesh, symmetry))
    return figures


def mean_abs_mm(estimate: NDArray[np.floating], truth: NDArray[np.floating], where: Mask) -> float:
    """Mean absolute difference in mm over `where`, pixels without a value left out; NaN if none is left."""
    gap = np.abs(np.asarray(estimate, dtype=np.float64) - truth)[where]
    gap = gap[np.isfinite(gap)]
    return float(gap.mean()) if gap.size else math.nan


def iou(a: Mask, b: Mask) -> float:
    """Intersection over union of two masks; 1 when both are empty."""
    union = int(np.count_nonzero(a | b))
    return np.count_nonzero(a & b) / union if union else 1.0


def psnr_db(a: NDArray[np.generic], b: NDArray[np.generic], peak: float) -> float:
    """Peak signal-to-noise ratio in dB, at most `PSNR_CAP_DB`; NaN pixels are left out."""
    gap = a.astype(np.float64) - b.astype(np.float64)
    mse = float(np.nanmean(gap * gap))
    return min(PSNR_CAP_DB, 10.0 * math.log10(peak * peak / mse)) if mse > 0 else PSNR_CAP_DB


def _surface(stage: str, indentation_mm: NDArray[np.floating], contact: Mask, truth: Truth) -> dict[str, float]:
    figures: dict[str, float] = {}
    if truth.contact is not None and truth.contact.shape == contact.shape:
        figures[f"{stage}.contact_iou"] = iou(contact, truth.contact)
    if truth.indentation_mm is not None and truth.indentation_mm.shape == indentation_mm.shape:
        everywhere = np.ones(contact.shape, dtype=np.bool_)
        figures[f"{stage}.mae_mm"] = mean_abs_mm(indentation_mm, truth.indentation_mm, everywhere)
        if truth.contact is not None and truth.contact.any():
            figures[f"{stage}.contact_mae_mm"] = mean_abs_mm(indentation_mm, truth.indentation_mm, truth.contact)
    return figures


def _picture(touch: Touch, frame: TactileFrame) -> dict[str, float]:
    if touch.image.shape != frame.image.shape:
        return {}
    if frame.is_depth:
        everywhere = np.ones(touch.image.shape, dtype=np.bool_)
        return {"generate.depth_mae_mm": mean_abs_mm(touch.depth_mm, np.asarray(frame.image, np.float64), everywhere)}
    return {"generate.psnr_db": psnr_db(touch.image, frame.image, 255.0)}


def _pose(pose: ObjectPose, truth: Truth, mesh: Mesh | None, symmetry: Symmetry | None) -> dict[str, float]:
    if pose.sensor_from_object is None or truth.sensor_from_object is None:
        return {}
    centre = pose.scene_mm.astype(np.float64).mean(axis=0)
    # The error is stated at the contact: a far-away object origin would turn a small angle into a large shift.
    in_object = rigid.apply(rigid.invert(truth.sensor_from_object), centre)
    off = rigid.apply(pose.sensor_from_object, in_object) - centre
    turn = rigid.invert(truth.sensor_from_object) @ pose.sensor_from_object
    figures = {"pose.translation_mm": float(np.linalg.norm(off)), "pose.rotation_deg": rigid.angle_deg(turn)}
    if mesh is not None:
        felt = symmetric_error(
            pose.sensor_from_object, truth.sensor_from_object, mesh, symmetry, centre, pose.observable
        )  # fmt: skip
        figures |= {f"pose.{name}": value for name, value in asdict(felt).items() if math.isfinite(value)}
        several = ambiguity((pose.sensor_from_object, *pose.alternatives), mesh, symmetry, _SAME_MM)
        figures |= {"pose.answers": float(several.n_distinct), "pose.answers_apart_mm": several.spread_mm}
    return figures
