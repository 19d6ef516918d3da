"""Metrics of stage results against ground truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import ObjectPose
from pipeline.stages.metrics.symmetric_pose_error import compute_ambiguity, compute_symmetric_error

if TYPE_CHECKING:
    from pipeline.core.geometry.symmetry import Symmetry

_SAME_MM = 1.0  # poses this close are one
PSNR_CAP_DB = 100.0  # identical images have no finite ratio; published tables cap it too


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A metric's unit, direction and short title."""

    title: str = ""
    unit: str
    meaning: str
    better: Literal["lower", "higher", "neither"] = "lower"


METRICS: Mapping[str, Metric] = {
    "mae_mm": Metric(
        title="error", unit="mm", meaning="mean absolute error of indentation over the whole image"
    ),
    "contact_mae_mm": Metric(
        title="error in contact",
        unit="mm",
        meaning="mean absolute error of indentation inside the true contact",
    ),
    "contact_iou": Metric(
        title="IoU of contact",
        unit="",
        meaning="intersection over union of contact and true contact",
        better="higher",
    ),
    "psnr_db": Metric(
        title="PSNR",
        unit="dB",
        meaning="peak signal-to-noise ratio of the generated image",
        better="higher",
    ),
    "depth_mae_mm": Metric(
        title="depth image error",
        unit="mm",
        meaning="mean absolute difference to the recorded depth image",
    ),
    "translation_mm": Metric(
        title="translation error",
        unit="mm",
        meaning="translation error of the object at the contact",
    ),
    "rotation_deg": Metric(
        title="rotation error", unit="deg", meaning="rotation error of the object"
    ),
    "mssd_mm": Metric(
        title="MSSD", unit="mm", meaning="maximum symmetry-aware surface distance of the object"
    ),
    "se2_mm": Metric(
        title="in-plane translation error",
        unit="mm",
        meaning="in the sensor's plane, symmetry-aware",
    ),
    "se2_deg": Metric(
        title="in-plane rotation error", unit="deg", meaning="in the sensor's plane, symmetry-aware"
    ),
    "observable_mm": Metric(
        title="observable translation error", unit="mm", meaning="along determined directions"
    ),
    "observable_deg": Metric(
        title="observable rotation error", unit="deg", meaning="about determined axes"
    ),
    "n_poses": Metric(
        title="poses",
        unit="",
        meaning="poses that fit equally well, up to symmetry",
        better="neither",
    ),
    "pose_spread_mm": Metric(
        title="pose ambiguity",
        unit="mm",
        meaning="largest distance (MSSD) between two of these poses",
        better="neither",
    ),
    "round_trip_mm": Metric(
        title="round-trip error",
        unit="mm",
        meaning="mean absolute change of indentation in contact, to the target and back",
    ),
    "training_distance": Metric(
        title="distance from training",
        unit="",
        meaning="of the touch from training touches; beyond 1 it is unlike",
    ),
    "n_warnings": Metric(title="warnings", unit="", meaning="warnings that not every frame has"),
    "max_indentation_mm": Metric(
        title="largest indentation",
        unit="mm",
        meaning="of the source sensor in contact",
        better="neither",
    ),
    "contact_area_mm2": Metric(
        title="contact area", unit="mm²", meaning="on the source sensor", better="neither"
    ),
    "force_n": Metric(
        title="force",
        unit="N",
        meaning="normal force of the contact model, scaled by weighings",
        better="neither",
    ),
    "uncalibrated_force_n": Metric(
        title="force (scale unknown)",
        unit="N",
        meaning="normal force of the contact model with the described sensor: compare frames of "
        "one sensor only",
        better="neither",
    ),
    "true_force_n": Metric(
        title="true force", unit="N", meaning="normal force of the recording", better="neither"
    ),
    "shear_n": Metric(
        title="shear force",
        unit="N",
        meaning="along the gel, by its markers; scaled as the force",
        better="neither",
    ),
    "uncalibrated_shear_n": Metric(
        title="shear force (scale unknown)",
        unit="N",
        meaning="along the described gel, by its markers: compare it with the force, and frames "
        "of one sensor only",
        better="neither",
    ),
    "true_shear_n": Metric(
        title="true shear force", unit="N", meaning="of the recording", better="neither"
    ),
    "shear_direction_deg": Metric(
        title="shear direction",
        unit="deg",
        meaning="in the image: 0 to the right, 90 down",
        better="neither",
    ),
}
"""Name of a metric within its stage (`mssd_mm` of `pose.mssd_mm`) -> its description."""
# stands for the stage in metrics of a whole frame, which need no truth: `frame.round_trip_mm`
WITHOUT_TRUTH = "frame"
ROUND_TRIP = f"{WITHOUT_TRUTH}.round_trip_mm"
TRAINING_DISTANCE = f"{WITHOUT_TRUTH}.training_distance"
FORCE, UNCALIBRATED_FORCE, TRUE_FORCE = (
    f"{WITHOUT_TRUTH}.{of}force_n" for of in ("", "uncalibrated_", "true_")
)
SHEAR, UNCALIBRATED_SHEAR, TRUE_SHEAR = (
    f"{WITHOUT_TRUTH}.{of}shear_n" for of in ("", "uncalibrated_", "true_")
)
SHEAR_DIRECTION = f"{WITHOUT_TRUTH}.shear_direction_deg"


def describe_metric(figure: str) -> str:
    """Return the title of `touch_depth.contact_mae_mm`: "touch depth: error in contact, mm"."""
    stage, _, name = figure.partition(".")
    metric = METRICS[name]
    of = "" if stage == WITHOUT_TRUTH else f"{stage.replace('_', ' ')}: "
    return f"{of}{metric.title}{', ' if metric.unit else ''}{metric.unit}"


def is_stage_error(figure: str) -> bool:
    """Whether `stage.name` is an error of a stage against truth, smaller is better."""
    stage, _, name = figure.partition(".")
    return stage != WITHOUT_TRUTH and METRICS[name].better == "lower"


def compute_mae_mm(
    estimate: NDArray[np.floating], truth: NDArray[np.floating], where: Mask
) -> float:
    """Mean absolute difference in mm over `where`, pixels without a value left out.

    NaN if none is left.
    """
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


def compute_surface_metrics(
    indentation_mm: NDArray[np.floating], contact: Mask, truth: Truth
) -> dict[str, float]:
    """Compare a membrane (rows, cols) to its ground truth; empty where that has another size."""
    figures: dict[str, float] = {}
    if truth.contact is not None and truth.contact.shape == contact.shape:
        figures["contact_iou"] = iou(contact, truth.contact)
    if truth.indentation_mm is not None and truth.indentation_mm.shape == indentation_mm.shape:
        everywhere = np.ones(contact.shape, dtype=np.bool_)
        figures["mae_mm"] = compute_mae_mm(indentation_mm, truth.indentation_mm, everywhere)
        if truth.contact is not None and truth.contact.any():
            figures["contact_mae_mm"] = compute_mae_mm(
                indentation_mm, truth.indentation_mm, truth.contact
            )
    return figures


def compute_image_metrics(image: Image | Floats, frame: TactileFrame) -> dict[str, float]:
    """Compare a generated image to the recorded one; empty where that has another size."""
    if image.shape != frame.image.shape:
        return {}
    if frame.is_depth:
        everywhere = np.ones(image.shape, dtype=np.bool_)
        return {
            "depth_mae_mm": compute_mae_mm(
                np.asarray(image, np.float64), np.asarray(frame.image, np.float64), everywhere
            )
        }
    return {"psnr_db": psnr_db(image, frame.image, 255.0)}


def compute_pose_metrics(
    pose: ObjectPose, truth: Truth, mesh: Mesh | None = None, symmetry: Symmetry | None = None
) -> dict[str, float]:
    """Compare a pose to the true one; `mesh` and its `symmetry` (None = none) are the object's.

    `translation_mm` and `rotation_deg` ignore symmetry; `mssd_mm`, `se2_mm`, `se2_deg`,
    `observable_mm` and `observable_deg` are those of `SymmetricPoseError`.
    """
    if pose.sensor_from_object is None or truth.sensor_from_object is None:
        return {}
    centre = pose.scene_mm.astype(np.float64).mean(axis=0)
    # The error is stated at the contact: a distant object origin would turn a small angle into a
    # large translation.
    in_object = rigid.apply(rigid.invert(truth.sensor_from_object), centre)
    off = rigid.apply(pose.sensor_from_object, in_object) - centre
    turn = rigid.invert(truth.sensor_from_object) @ pose.sensor_from_object
    figures = {
        "translation_mm": float(np.linalg.norm(off)),
        "rotation_deg": rigid.rotation_angle_deg(turn),
    }
    if mesh is not None:
        error = compute_symmetric_error(
            pose.sensor_from_object,
            truth.sensor_from_object,
            mesh,
            symmetry,
            centre,
            pose.observable,
        )
        figures |= {
            f"{name}": value for name, value in asdict(error).items() if math.isfinite(value)
        }
        ambiguity = compute_ambiguity(
            (pose.sensor_from_object, *pose.alternatives), mesh, symmetry, _SAME_MM
        )
        figures |= {"n_poses": float(ambiguity.n_distinct), "pose_spread_mm": ambiguity.spread_mm}
    return figures
