"""The paper's released pose evaluation: point-to-point ICP of projections in the sensor plane, for comparison.

Its choices are kept as they are: every felt point takes the nearest model point however far it is, many to one; the
number of iterations is fixed; nothing tells the side of the object that touches, nor what the contact leaves open.
Two things are made sound: every draw is seeded, and lengths are millimetres. `pipeline/stages/pose.py` is what to use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pipeline.base.arrays import Doubles, freeze
from pipeline.base.errors import SettingProblem, ShapeError
from pipeline.base.progress import SILENT, Progress
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh, sample_surface

N_MODEL = 5000  # points that the model's surface is sampled at
FEWEST = 4  # felt points; with fewer the start is the answer
INLIER_MM = 15.0  # distance within which fitness and rmse count a pair: wide enough to count nearly all
SWEEP_DEG = tuple(-22.5 + 5.0 * k for k in range(10))
N_DRAWS = 10
_DRAWN_MM = 10.0  # in-plane shifts of random starts lie within this

Starts = Literal["identity", "sweep", "random"]
Axis = Literal["x", "y", "z"]
_PLANE: dict[Axis, tuple[int, int]] = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}  # a turn about the axis is positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Planar:
    """How the planar registration is done; the defaults are those of the released evaluation."""

    axis: Axis = "x"  # along which the clouds are projected: x of a grasp frame, z of a sensor frame
    n_iterations: int = 200  # the released class has 20, its evaluation asks for 200
    starts: Starts = "identity"  # "sweep": -22.5 to 22.5 degrees by 5; "random": ten draws of angle and shift
    seed: int = 0
    keep_steps: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarStep:
    """One iteration of the start that was chosen."""

    scene_from_model: Doubles  # (4, 4) mm, a turn about the axis and a shift square to it
    rmse_mm: float  # over all felt points, to the model points that they were paired with


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarFit:
    """Where the planar registration ended."""

    scene_from_model: Doubles  # (4, 4) mm
    angle_deg: float  # about the axis, within -180 and 180, from where the model was placed
    shift_mm: tuple[float, float]  # along the two axes of the plane, in cyclic order after the projection's axis
    fitness: float  # share of model points with a felt point within `INLIER_MM`, in 3D
    inlier_rmse_mm: float  # of those; the chosen start has the least
    start_deg: float
    steps: tuple[PlanarStep, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class AngleScore:
    """The released score: angles alone, over many touches."""

    mean_deg: float
    std_deg: float
    within_5_deg: float  # share
    within_10_deg: float


def model_cloud(mesh: Mesh, seed: int = 0) -> Doubles:
    """The model as (5000, 3) points by area, in mm."""
    return sample_surface(mesh, N_MODEL, seed)[0]


def planar_registration(
    model_points_mm: Doubles,
    scene_points_mm: Doubles,
    how: Planar,
    progress: Progress = SILENT,
    *,
    placed: Doubles | None = None,
) -> PlanarFit:
    """The turn and shift in the plane that lay the model's projection on the scene's.

    Each of a fixed number of iterations pairs every felt point with the nearest model point in the plane and solves
    for the motion in closed form (Kabsch in 2D). Of several starts the one of least inlier rmse in 3D is kept, as the
    released code does. The clouds share a frame in which the identity is nearly right, as in a recorded grasp;
    elsewhere `placed` (4, 4) brings the model there, and `scene_from_model` of the result includes it.

    Raises ShapeError for clouds that are not (n, 3) and finite or a model without points, SettingProblem for fewer
    than one iteration.
    """
    _check(model_points_mm, scene_points_mm, how)
    there = rigid.identity() if placed is None else placed
    if len(scene_points_mm) < FEWEST:
        note = f"only {len(scene_points_mm)} felt points: the start is kept"
        return _fit(rigid.identity(), there, 0.0, math.nan, 0.0, how, (), (note,))
    from scipy.spatial import KDTree

    felt, columns = KDTree(scene_points_mm), list(_PLANE[how.axis])
    model_mm = rigid.apply(there, model_points_mm)
    model_2d, scene_2d = model_mm[:, columns], scene_points_mm[:, columns]
    best: tuple[float, float, Doubles, float, tuple[PlanarStep, ...]] | None = None
    tried = starts(how)
    for k, start in enumerate(tried):
        progress.step(k / len(tried), f"planar start {k + 1} of {len(tried)}")
        found, steps = _iterated(model_2d, scene_2d, start, how)
        pose = _lifted(found, how.axis)
        fitness, rmse_mm = _evaluated(rigid.apply(pose, model_mm), felt)
        if best is None or rmse_mm < best[0]:
            best = (rmse_mm, fitness, pose, _angle_deg(start), steps)
    assert best is not None
    rmse_mm, fitness, pose, start_deg, steps = best
    steps = tuple(replace(step, scene_from_model=freeze(step.scene_from_model @ there)) for step in steps)
    return _fit(pose, there, fitness, rmse_mm, start_deg, how, steps, ())


def starts(how: Planar) -> tuple[Doubles, ...]:
    """First guesses as (3, 3) motions of the plane."""
    if how.starts == "identity":
        return (np.eye(3),)
    if how.starts == "sweep":
        return tuple(_motion(math.radians(deg), np.zeros(2)) for deg in SWEEP_DEG)
    rng = np.random.default_rng(how.seed)
    degrees = rng.choice(np.linspace(SWEEP_DEG[0], -SWEEP_DEG[0], N_DRAWS), size=N_DRAWS)
    shifts = rng.uniform(-_DRAWN_MM, _DRAWN_MM, (N_DRAWS, 2))
    return tuple(_motion(math.radians(float(deg)), shift) for deg, shift in zip(degrees, shifts, strict=True))


def angle_score(angles_deg: Doubles, true_deg: Doubles, *, wrap: bool) -> AngleScore:
    """|angle - truth| over touches (n,); `wrap` False is the released score, for which 359 and 1 are 358 apart.

    Raises ShapeError when there is nothing to score or the two do not agree.
    """
    if len(angles_deg) == 0 or angles_deg.shape != true_deg.shape:
        raise ShapeError(f"want as many true angles as angles, at least one, got {len(true_deg)} and {len(angles_deg)}")
    off = np.abs(angles_deg - true_deg)
    if wrap:
        off = np.abs((off + 180.0) % 360.0 - 180.0)
    return AngleScore(
        mean_deg=float(off.mean()), std_deg=float(off.std()),
        within_5_deg=float((off <= 5.0).mean()), within_10_deg=float((off <= 10.0).mean()),
    )  # fmt: skip


def _check(model: Doubles, scene: Doubles, how: Planar) -> None:
    for points, what in ((model, "model"), (scene, "scene")):
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ShapeError(f"the {what} must be finite points of shape (n, 3), got {points.shape}")
    if len(model) == 0:
        raise ShapeError("the model has no points")
    if how.n_iterations < 1:
        raise SettingProblem(f"a planar registration needs at least one iteration, got {how.n_iterations}")


def _iterated(
    model: Doubles, scene: Doubles, start: Doubles, how: Planar
) -> tuple[Doubles, tuple[PlanarStep, ...]]:  # fmt: skip
    """The motion (3, 3) of the model's plane after all iterations."""
    from scipy.spatial import KDTree

    # Nearest neighbours are the same whichever cloud moves: the tree of the model is built once.
    tree: Any = KDTree(model)
    motion, steps = start, list[PlanarStep]()
    for _ in range(how.n_iterations):
        back = _inverse(motion)
        _, index = tree.query(scene @ back[:2, :2].T + back[:2, 2])
        before, motion = motion, _kabsch(model[index], scene)
        if how.keep_steps:
            off = model[index] @ motion[:2, :2].T + motion[:2, 2] - scene
            rmse_mm = float(np.sqrt((off**2).sum(axis=1).mean()))
            steps.append(PlanarStep(scene_from_model=freeze(_lifted(motion, how.axis)), rmse_mm=rmse_mm))
        if np.array_equal(before, motion):
            break  # equal pairs give equal motions: every further iteration would change nothing
    return motion, tuple(steps)


def _kabsch(model: Doubles, scene: Doubles) -> Doubles:
    """The motion (3, 3) that takes paired points (n, 2) of the model closest to those of the scene."""
    middle_m, middle_s = model.mean(axis=0), scene.mean(axis=0)
    w = (scene - middle_s).T @ (model - middle_m)
    turned = _motion(math.atan2(w[1, 0] - w[0, 1], w[0, 0] + w[1, 1]), np.zeros(2))
    turned[:2, 2] = middle_s - turned[:2, :2] @ middle_m
    return turned


def _evaluated(model_mm: Doubles, felt: Any) -> tuple[float, float]:
    """(share of the placed model's points within `INLIER_MM` of a felt point, their rms distance in mm)."""
    distance, _ = felt.query(model_mm, distance_upper_bound=INLIER_MM)
    near = np.isfinite(distance)
    return float(near.mean()), float(np.sqrt((distance[near] ** 2).mean())) if near.any() else math.inf


def _fit(
    pose: Doubles, there: Doubles, fitness: float, rmse_mm: float, start_deg: float, how: Planar,
    steps: tuple[PlanarStep, ...], notes: tuple[str, ...],
) -> PlanarFit:  # fmt: skip
    u, v = _PLANE[how.axis]
    return PlanarFit(
        scene_from_model=freeze(pose @ there), angle_deg=math.degrees(math.atan2(pose[v, u], pose[u, u])),
        shift_mm=(float(pose[u, 3]), float(pose[v, 3])), fitness=fitness, inlier_rmse_mm=rmse_mm,
        start_deg=start_deg, steps=steps, notes=notes,
    )  # fmt: skip


def _motion(angle_rad: float, shift: Doubles) -> Doubles:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, shift[0]], [s, c, shift[1]], [0.0, 0.0, 1.0]])


def _inverse(motion: Doubles) -> Doubles:
    inverse = np.eye(3)
    inverse[:2, :2] = motion[:2, :2].T
    inverse[:2, 2] = -motion[:2, :2].T @ motion[:2, 2]
    return inverse


def _angle_deg(motion: Doubles) -> float:
    return math.degrees(math.atan2(motion[1, 0], motion[0, 0]))


def _lifted(motion: Doubles, axis: Axis) -> Doubles:
    """The motion of the plane as one of space."""
    columns = list(_PLANE[axis])
    pose = np.eye(4)
    pose[np.ix_(columns, columns)] = motion[:2, :2]
    pose[columns, 3] = motion[:2, 2]
    return pose
