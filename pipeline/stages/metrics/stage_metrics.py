"""Metrics of stage results against ground truth.

Pose errors that ignore rotations mapping an object onto itself, and unobservable motions.

A symmetry is that of the whole object. One touch can be more symmetric: a hex key's shaft is a rod
while its elbow is out of view (BOP-Distrib). `compute_observable_error` covers that, touch by
touch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Doubles, Floats, Image, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import ObjectPose

if TYPE_CHECKING:
    from pipeline.core.geometry.symmetry import Symmetry


SYMMETRY_STEP = 0.01  # of the diameter, between neighbouring turns about an axis
_FEW = 500  # vertices below which their convex hull is not worth its time
# vertices that rank the symmetries, and symmetries that are then looked at together
_ROUGH = 48
_AT_ONCE = 8
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_NARROWED = 24  # golden sections: to a hundred thousandth of the first bracket
_SMALL_RAD = 1e-4


@frozen
class SymmetricPoseError:
    """Errors of an estimate against the true pose."""

    mssd_mm: float  # largest displacement of a vertex, least over the symmetries
    se2_mm: float  # in the sensor plane, at the contact; for a body of revolution between the axes
    se2_deg: float  # about the sensor's optical axis; for a body of revolution between the axes
    # translation of the contact's centre along determined directions; NaN = unknown
    observable_mm: float
    observable_deg: float


@frozen
class Ambiguity:
    """Poses that fit equally well."""

    n_distinct: int  # not mapped onto each other by a symmetry
    spread_mm: float  # largest MSSD between two of them


def compute_symmetric_error(
    estimate: Doubles,
    truth: Doubles,
    mesh: Mesh,
    symmetry: Symmetry | None,
    at_mm: Doubles,
    observable: Doubles | None = None,
) -> SymmetricPoseError:
    """Compute all errors of sensor_from_object (4, 4) at the contact's centre `at_mm` (3,) in the
    sensor frame.

    `symmetry` None = unknown: the object counts as asymmetric. `observable` is that of
    `ObjectPose`.
    """
    mssd, turn = _nearest(estimate, truth, compute_hull(mesh), symmetry)
    same = truth @ turn
    shift, angle = compute_in_plane_error(
        estimate, remove_axis_rotation(estimate, same, symmetry), symmetry, at_mm
    )
    seen = math.nan
    seen_angle = math.nan
    if observable is not None:
        seen, seen_angle = compute_observable_error(
            estimate, remove_axis_rotation(estimate, same, symmetry), observable, at_mm
        )
    return SymmetricPoseError(
        mssd_mm=mssd, se2_mm=shift, se2_deg=angle, observable_mm=seen, observable_deg=seen_angle
    )


def compute_in_plane_error(
    estimate: Doubles, truth: Doubles, symmetry: Symmetry | None, at_mm: Doubles
) -> tuple[float, float]:
    """Return (mm, deg) in the sensor's x-y plane, as in the paper, for a true pose already reduced
    by symmetry.

    The translation is that of the object's point at `at_mm`. A body of revolution is compared by
    its axis alone: translations along the axis count in the MSSD only.
    """
    motion = estimate @ rigid.invert(truth)
    shift = rigid.apply(motion, at_mm) - at_mm
    if symmetry is not None and symmetry.axis is not None:
        axis = estimate[:3, :3] @ symmetry.axis
        shift = shift - axis * (axis @ shift)
    turn_rad = rigid.rotation_vector_rad(motion)[2]
    return float(np.hypot(shift[0], shift[1])), abs(math.degrees(turn_rad))


def compute_observable_error(
    estimate: Doubles, truth: Doubles, observable: Doubles, at_mm: Doubles
) -> tuple[float, float]:
    """Return (mm, deg) of the motion from true pose to estimate within the determined directions.

    The motion is a screw about `at_mm` (the logarithm in SE(3)), so that a long translation and a
    full roll along a rod, about a ball or over a plate stay within their directions, which are
    closed under composition.
    """
    middle = rigid.translation(*at_mm)
    screw = _screw(rigid.invert(middle) @ estimate @ rigid.invert(truth) @ middle)
    seen = observable @ screw
    return float(np.linalg.norm(seen[3:])), math.degrees(float(np.linalg.norm(seen[:3])))


def compute_ambiguity(
    poses: Sequence[Doubles], mesh: Mesh, symmetry: Symmetry | None, same_mm: float
) -> Ambiguity:
    """Count the distinct poses of a registration: those within `same_mm` of MSSD of an earlier
    one count once.
    """
    corners = compute_hull(mesh)
    kept = list[Doubles]()
    spread = 0.0
    for pose in poses:
        apart = [_nearest(pose, other, corners, symmetry)[0] for other in kept]
        if all(mm > same_mm for mm in apart):
            kept.append(pose)
            spread = max([spread, *apart])
    return Ambiguity(n_distinct=len(kept), spread_mm=spread)


def compute_hull(mesh: Mesh) -> Doubles:
    """Return the vertices (n, 3) of the convex hull: displacement is convex, so its maximum is
    there.
    """
    return mesh.vertices_mm if len(mesh.vertices_mm) <= _FEW else _hull_of(mesh.vertices_mm)


@derive_once
def _hull_of(vertices_mm: Doubles) -> Doubles:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return freeze(vertices_mm[ConvexHull(vertices_mm).vertices])
    except QhullError:  # a flat mesh has no hull
        return vertices_mm


def _nearest(
    estimate: Doubles, truth: Doubles, points: Doubles, symmetry: Symmetry | None
) -> tuple[float, Doubles]:
    """Return (least MSSD in mm, its symmetry (4, 4)).

    Maximum symmetry-aware surface distance of BOP: min over S of max over vertices x of |estimate x
    - truth S x|. A continuous symmetry is searched at steps of one percent of the diameter, and
    then between the steps.
    """
    if symmetry is None:
        return _farthest(estimate, truth, np.eye(3)[None], points)[0], np.eye(4)
    group = symmetry.sample_rotations(SYMMETRY_STEP)
    at_least = _farthest(estimate, truth, group, points[:: max(1, len(points) // _ROUGH)])
    best = math.inf
    turn = group[0]
    for part in np.array_split(
        np.argsort(at_least, kind="stable"), math.ceil(len(group) / _AT_ONCE)
    ):
        if at_least[part[0]] >= best:
            break
        all_mm = _farthest(estimate, truth, group[part], points)
        k = int(np.argmin(all_mm))
        best, turn = min((best, turn), (float(all_mm[k]), group[part[k]]), key=lambda each: each[0])
    if symmetry.axis is not None:
        best, turn = _between_steps(estimate, truth, points, turn, symmetry.axis, best)
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    return best, matrix


def _farthest(estimate: Doubles, truth: Doubles, turns: Doubles, points: Doubles) -> Doubles:
    """Return (k,) largest displacement (mm) of a point, for each rotation (k, 3, 3) applied
    before the true pose.
    """
    difference = estimate[:3, :3] - truth[:3, :3] @ turns
    shift = estimate[:3, 3] - truth[:3, 3]
    return np.sqrt(((difference @ points.T + shift[:, None]) ** 2).sum(axis=1).max(axis=1))


def _between_steps(
    estimate: Doubles, truth: Doubles, points: Doubles, turn: Doubles, axis: Doubles, best: float
) -> tuple[float, Doubles]:
    """Return the least MSSD near `turn` by golden section over one step either way."""

    def at(angle: float) -> tuple[float, Doubles]:
        turned = turn @ rigid.rotation(angle * axis)[:3, :3]
        return float(_farthest(estimate, truth, turned[None], points)[0]), turned

    low = -2.0 * SYMMETRY_STEP
    high = 2.0 * SYMMETRY_STEP
    found = (best, turn)
    for _ in range(_NARROWED):
        left = at(high - _GOLDEN * (high - low))
        right = at(low + _GOLDEN * (high - low))
        if left[0] < right[0]:
            high = low + _GOLDEN * (high - low)
        else:
            low = high - _GOLDEN * (high - low)
        found = min(found, left, right, key=lambda each: each[0])
    return found


def remove_axis_rotation(estimate: Doubles, truth: Doubles, symmetry: Symmetry | None) -> Doubles:
    """Return the true pose after the rotation about the symmetry axis that minimises the error
    (swing and twist).
    """
    if symmetry is None or symmetry.axis is None:
        return truth
    between = truth[:3, :3].T @ estimate[:3, :3]
    # cos and sin of the twist, both times one positive number.
    along = symmetry.axis @ np.array(
        [
            between[2, 1] - between[1, 2],
            between[0, 2] - between[2, 0],
            between[1, 0] - between[0, 1],
        ]
    )
    twist = math.atan2(
        along, float(np.trace(between)) - float(symmetry.axis @ between @ symmetry.axis)
    )
    return truth @ rigid.rotation(twist * symmetry.axis)


def _screw(motion: Doubles) -> Doubles:
    """Return the logarithm (6,) of a rigid motion: rotation vector, and translation per unit of
    the motion along it.
    """
    turn = rigid.rotation_vector_rad(motion)
    angle = float(np.linalg.norm(turn))
    skew = rigid.cross_matrix(turn)
    curl = (
        1.0 / 12.0 if angle < _SMALL_RAD else (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
    )
    return np.concatenate([turn, (np.eye(3) - 0.5 * skew + curl * (skew @ skew)) @ motion[:3, 3]])


_SAME_MM = 1.0  # poses this close are one
PSNR_CAP_DB = 100.0  # identical images have no finite ratio; published tables cap it too


@frozen
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
        title="largest surface distance",
        unit="mm",
        meaning="largest distance between the object's surface at the estimated and the true pose, "
        "up to its symmetries (MSSD)",
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
