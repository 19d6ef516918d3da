"""Port of the paper's released pose evaluation: point-to-point ICP of projections in the sensor
plane, for comparison.

Its choices are kept: every contact point takes the nearest model point at any distance, many to
one; the number of iterations is fixed; the side of the object and unobservable motions are not
considered. Starts are those of its sweep; the one of least rmse is used. A method of the pose
stage, and the protocol for both fingers of a grasp, run it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh, sample_surface
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.results import ObjectPose, PoseStep
from pipeline.stages.pose.registration.scene import list_starts
from pipeline.stages.pose.registration.search import PoseSearch

N_MODEL = 5000  # points sampled on the model's surface
MIN_POINTS = 4  # contact points; with fewer the start is returned
INLIER_MM = 15.0  # distance up to which fitness and rmse count a pair: wide enough for nearly all
_IN_PLANE = (1.0, 1.0, 0.0)
SWEEP_DEG = tuple(-22.5 + 5.0 * k for k in range(10))


@frozen
class PlanarFit:
    """Result of the planar registration."""

    scene_from_model: Doubles  # (4, 4) mm
    fitness: float  # share of model points with a contact point within `INLIER_MM`, in 3D
    inlier_rmse_mm: float  # over those; the chosen start has the least
    stop_reason: str = ""  # of the chosen start, in words
    # of the chosen start; rmse over all contact points, to their partners
    steps: tuple[PoseStep, ...] = ()
    notes: tuple[str, ...] = ()


def register_planar(
    model_points_mm: Doubles,
    scene_points_mm: Doubles,
    placed: Doubles,
    n_iterations: int,
    progress: Progress = SILENT,
    *,
    keep_steps: bool = False,
    starts_deg: Sequence[float] = SWEEP_DEG,
) -> PlanarFit:
    """Fit the projection of the model, `placed` (4, 4), to the scene's by rotation about z and
    in-plane translation.

    Each of a fixed number of iterations pairs every contact point with the nearest model point in
    the plane and solves for the motion in closed form (Kabsch in 2D). The start of least inlier
    rmse in 3D is used, as in the released code. Raises ShapeError for clouds that are not (n, 3)
    and finite or a model without points, SettingProblem for fewer than one iteration.
    """
    if len(scene_points_mm) < MIN_POINTS:
        note = f"only {len(scene_points_mm)} contact points: the start is returned"
        return PlanarFit(
            scene_from_model=freeze(placed.copy()),
            fitness=0.0,
            inlier_rmse_mm=math.nan,
            notes=(note,),
        )
    from scipy.spatial import KDTree

    contact_tree = KDTree(scene_points_mm)
    model_mm = rigid.apply(placed, model_points_mm)
    best: tuple[float, float, Doubles, list[tuple[Doubles, float]]] | None = None
    for k, start_deg in enumerate(starts_deg):
        progress.step(k / len(starts_deg), f"planar start {k + 1} of {len(starts_deg)}")
        start = rigid.rotation((0.0, 0.0, math.radians(start_deg)))
        pose, steps = _iterate(
            model_mm * _IN_PLANE, scene_points_mm * _IN_PLANE, start, n_iterations
        )
        fitness, rmse_mm = _evaluate(rigid.apply(pose, model_mm), contact_tree)
        if best is None or rmse_mm < best[0]:
            best = (rmse_mm, fitness, pose, steps)
    assert best is not None
    rmse_mm, fitness, pose, steps = best
    kept = steps if keep_steps else []
    return PlanarFit(
        scene_from_model=freeze(pose @ placed),
        fitness=fitness,
        inlier_rmse_mm=rmse_mm,
        stop_reason=_describe_stop(len(steps), n_iterations),
        steps=tuple(
            PoseStep(sensor_from_object=freeze(motion @ placed), rmse_mm=off_mm, fitness=fitness)
            for motion, off_mm in kept
        ),
    )


def _iterate(
    model: Doubles, scene: Doubles, start: Doubles, n_iterations: int
) -> tuple[Doubles, list[tuple[Doubles, float]]]:
    """Return the motion (4, 4) of the model in its plane after all iterations.

    And each with its rmse (mm).
    """
    from scipy.spatial import KDTree

    # Nearest neighbours do not depend on which cloud moves: the model's tree is built once.
    tree: Any = KDTree(model[:, :2])
    motion = start
    steps = list[tuple[Doubles, float]]()
    for _ in range(n_iterations):
        _, index = tree.query(rigid.apply(rigid.invert(motion), scene)[:, :2])
        before = motion
        motion = _kabsch(model[index], scene)
        off = rigid.apply(motion, model[index]) - scene
        steps.append((motion, float(np.sqrt((off**2).sum(axis=1).mean()))))
        if np.array_equal(before, motion):
            break  # equal pairs give equal motions from here on
    return motion, steps


def _describe_stop(n: int, most: int) -> str:
    if n < most:
        return "converged: the last two iterations paired the points alike"
    return f"ended after {n} iterations, the limit of the released code"


def _kabsch(model: Doubles, scene: Doubles) -> Doubles:
    """Return the motion (4, 4) that takes paired points (n, 3) of the model's plane closest to
    the scene's.
    """
    middle_m = model.mean(axis=0)
    middle_s = scene.mean(axis=0)
    w = (scene - middle_s).T @ (model - middle_m)
    turned = rigid.rotation((0.0, 0.0, math.atan2(w[1, 0] - w[0, 1], w[0, 0] + w[1, 1])))
    turned[:3, 3] = middle_s - turned[:3, :3] @ middle_m
    return turned


def _evaluate(model_mm: Doubles, contact_tree: Any) -> tuple[float, float]:
    """Return (share of placed model points within `INLIER_MM` of a contact point, their rms
    distance in mm).
    """
    distance, _ = contact_tree.query(model_mm, distance_upper_bound=INLIER_MM)
    near = np.isfinite(distance)
    return float(near.mean()), float(
        np.sqrt((distance[near] ** 2).mean())
    ) if near.any() else math.inf


NOTE = (
    "paper 2D: in-plane turn and shift only; height and tilt keep their initial values, no "
    "uncertainty is known"
)
_FACE = "+z"  # default face


def estimate_planar_pose(
    search: PoseSearch, mesh: Mesh, face: str, progress: Progress = SILENT
) -> ObjectPose:
    """Register projections along the sensor's axis point to point.

    The centre of a face starts on the contact.
    """
    scene = search.scene
    chosen = _FACE if face == "auto" else face
    placed = list_starts(scene, search.object.model, chosen, 1)[0].sensor_from_object
    model_mm = sample_surface(mesh, N_MODEL, 0)[0]
    fit = register_planar(
        model_mm,
        scene.points_mm,
        placed,
        search.n_iterations,
        progress,
        keep_steps=search.keep_steps,
    )
    by_default = (
        ()
        if face != "auto"
        else (f"the object is taken to show its {_FACE} side; choose the face toward the sensor",)
    )
    return replace(
        scene.no_pose,
        sensor_from_object=fit.scene_from_model,
        rmse_mm=fit.inlier_rmse_mm,
        fitness=fit.fitness,
        steps=fit.steps,
        stop_reason=fit.stop_reason,
        starts_tried=len(SWEEP_DEG),
        notes=(NOTE, *by_default, *fit.notes),
    )


N_ITERATIONS = 200
# y, z, x: x becomes the axis
_PLANE_FROM_GRASP = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


@frozen
class GraspPoseError:
    """Errors in the grasp's plane."""

    translation_mm: float  # of the model's centre
    rotation_deg: float


def compute_grasp_pose_error(
    points_mm: Doubles, mesh: Mesh, grasp_from_object: Doubles
) -> GraspPoseError | None:
    """The paper's protocol as released: contact points (n, 3) of both fingers, registered in the
    grasp's plane.

    The points are joined in the grasp frame, whose x axis is the direction in which the fingers
    close, and projected along it; the start is the identity. The rotation about x is compared as
    the first Euler angle, without wrapping. The released code compares with the angle that was
    commanded, and scores no translation; here the tool's recorded pose is compared.

    None with too few points, which the released code answers with its start.
    """
    if len(points_mm) < MIN_POINTS:
        return None
    model_mm = sample_surface(mesh, N_MODEL, 0)[0]
    scene_mm = rigid.apply(_PLANE_FROM_GRASP, points_mm)
    fit = register_planar(
        model_mm, scene_mm, _PLANE_FROM_GRASP.copy(), N_ITERATIONS, starts_deg=(0.0,)
    )
    estimate = rigid.invert(_PLANE_FROM_GRASP) @ fit.scene_from_model
    centre = model_mm.mean(axis=0)[None]
    shift = (rigid.apply(estimate, centre) - rigid.apply(grasp_from_object, centre))[0]
    turned = compute_first_euler_deg(estimate) - compute_first_euler_deg(grasp_from_object)
    return GraspPoseError(
        translation_mm=math.hypot(float(shift[1]), float(shift[2])), rotation_deg=abs(turned)
    )


def compute_first_euler_deg(transform: Doubles) -> float:
    """The angle about x of a rotation R = Rx Ry Rz, in degrees, -180 to 180."""
    return math.degrees(math.atan2(-float(transform[1, 2]), float(transform[2, 2])))
