"""Pose: where the touched object is in the target sensor's frame (paper: ICP against the object's mesh).

A contact is a one-sided, partial view of the object, so a single ICP ends in some minimum, confidently. Here many first
guesses are compared by what was felt and by what was not, the best are registered, and what is left open is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline import rigid
from pipeline.arrays import Doubles, Floats, Indices, freeze
from pipeline.errors import SettingProblem
from pipeline.meshes import Mesh
from pipeline.params import setting
from pipeline.progress import SILENT, Progress
from pipeline.registration.icp import Fit, Registration, Surface, register, surface
from pipeline.registration.model import Model, sampled
from pipeline.registration.observability import Observability, observability
from pipeline.registration.outline import placed, shows
from pipeline.registration.ranking import Judge, apart, judge
from pipeline.registration.scene import Scene, felt_surface, in_reach
from pipeline.registration.starts import FACES, Start, starts
from pipeline.stages.results import ObjectPose, PoseStep, Touch

NO_CONTACT = "no contact: nothing was felt to find a pose from"
NO_MESH = "no object mesh was given; a pose needs one"
_MIN_POINTS = 20  # six unknowns, three times over
_N_MODEL = 30_000  # points on the whole object
_COARSE_FELT, _COARSE_MODEL = 80, 1000  # points that rank the first guesses
_FINE_FELT, _FINE_MODEL = 400, 4000  # points that rank what came out of them
_N_REGISTERED, _N_POLISHED = 16, 6
_COARSE_ITERATIONS = 12
_POLISHED_SHARE = 4.0  # the last registration searches this many times nearer
_STEP_POINTS = 500  # that the residual of a kept iteration is measured on
_OUTLINE_REACH_MM = 4.0  # object this far beyond the contact may stick out beside it
_MIN_FITNESS = 0.05  # share of the contact on the object below which there is no pose to speak of
_SAME_SURFACE = 0.5  # cosine of felt and modelled normal from which on both show one surface
_EQUAL_SHARE, _EQUAL_MM = 0.05, 0.005  # misfits this close are equal
_SAME_MM, _SAME_DEG = 1.0, 5.0  # poses this close are one


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseParams:
    """How the registration is done."""

    method: str = setting("point-to-plane", "Method", choices=("point-to-plane", "point-to-point"))
    face: str = setting(
        "auto", "Face toward the sensor", choices=("auto", *FACES), help="axis of the object that points at the sensor"
    )
    n_starts: int = setting(72, "Starts", low=1, high=1000, step=6, help="orientations that are tried")
    n_iterations: int = setting(30, "Iterations", low=1, high=500, step=5)
    max_distance_mm: float = setting(
        2.0, "Search distance", unit="mm", low=0.05, high=50.0, step=0.1, help="farther points are no partners"
    )
    max_points: int = setting(1500, "Points", low=50, high=100_000, step=100, help="contact points that are used")
    keep_steps: bool = setting(True, "Keep iterations")
    seed: int = setting(0, "Seed", low=0, high=2**31 - 1, step=1)


def pose(touch: Touch, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT) -> ObjectPose:
    """sensor_from_object (4, 4) in mm with its covariance and what it leaves open; None where it cannot be said.

    Raises MeshProblem when the mesh has no surface, SettingProblem for an unknown face or method.
    """
    early = without_contact(touch, mesh, params)
    if early is not None or mesh is None:
        return early or _unknown(NO_MESH)
    _check(params)
    scene = felt_surface(touch, params.max_points, params.seed)
    if len(scene.points_mm) < _MIN_POINTS:
        return _unknown(
            f"only {len(scene.points_mm)} contact points show a surface; a pose needs at least {_MIN_POINTS}", scene
        )
    progress.step(0.0, "spreading points over the object")
    model = sampled(mesh, _N_MODEL, params.seed)
    progress.step(0.05, "comparing first guesses")
    tried = starts(scene, model, params.face, params.n_starts)
    chosen = _most_promising(tried, judge(scene, model, _COARSE_FELT, _COARSE_MODEL, params.max_distance_mm))
    fine = judge(scene, model, _FINE_FELT, _FINE_MODEL, params.max_distance_mm)
    fits, misfits_mm = _registered(scene, model, chosen, fine, params, progress)
    if not fits or fits[0].fitness < _MIN_FITNESS:
        size_mm = float(np.ptp(mesh.vertices_mm, axis=0).max())
        return _unknown(
            f"the object, {size_mm:.3g} mm long, could not be laid on the contact; check the mesh's unit and face",
            scene,
        )
    fits[0] = _measured(fits[0], surface(mesh), scene, params)
    return _answer(scene, model, fits, misfits_mm, len(tried), params)


def without_contact(touch: Touch, mesh: Mesh | None, params: PoseParams) -> ObjectPose | None:  # noqa: ARG001
    """The answer "unknown" when there is no mesh or no contact, else None; same inputs as `pose`."""
    if not touch.contact.any():
        return _unknown(NO_CONTACT)
    return _unknown(NO_MESH) if mesh is None else None


def _check(params: PoseParams) -> None:
    if params.face not in ("auto", *FACES):
        raise SettingProblem(f"pose.face must be one of auto, {', '.join(FACES)}, got {params.face!r}")
    if params.method not in ("point-to-plane", "point-to-point"):
        raise SettingProblem(f"pose.method must be 'point-to-plane' or 'point-to-point', got {params.method!r}")


def _unknown(why: str, scene: Scene | None = None) -> ObjectPose:
    points, pixel = _frozen(scene)
    return ObjectPose(
        sensor_from_object=None, covariance=None, observable=None, weak=(), rmse_mm=math.nan, fitness=0.0,
        scene_mm=points, source_index=pixel, notes=(why,),
    )  # fmt: skip


def _frozen(scene: Scene | None) -> tuple[Floats, Indices]:
    if scene is None:
        return freeze(np.empty((0, 3), dtype=np.float32)), freeze(np.empty(0, dtype=np.int32))
    return freeze(scene.points_mm.astype(np.float32)), freeze(scene.pixel)


def _most_promising(tried: list[Start], by: Judge) -> list[Start]:
    """The best place of each orientation, the best orientations first."""
    misfits_mm = by.misfit_mm([s.sensor_from_object for s in tried])
    best: dict[tuple[str, int], Start] = {}
    for k in np.argsort(misfits_mm, kind="stable"):
        best.setdefault(tried[k].group, tried[k])
    return list(best.values())[:_N_REGISTERED]


def _registered(
    scene: Scene, model: Model, chosen: list[Start], by: Judge, params: PoseParams, progress: Progress
) -> tuple[list[Fit], Doubles]:
    """Polished fits, best first, and their misfits: all starts on a thinned scene, then the best on all of it."""
    coarse = Registration(
        method=params.method, n_iterations=_COARSE_ITERATIONS, max_distance_mm=params.max_distance_mm,
        n_points=_COARSE_FELT * 3,
    )  # fmt: skip
    few = model.thinned(_FINE_MODEL)
    rough: list[Fit] = []
    for k, start in enumerate(chosen):
        progress.step(0.1 + 0.6 * k / len(chosen), f"start {k + 1} of {len(chosen)}")
        rough.append(register(scene, few, start.sensor_from_object, coarse))
    rough = [fit for fit in rough if fit.fitness > 0]
    if not rough:
        return [], np.empty(0)
    return _polished(scene, model, _distinct(rough, by, scene)[:_N_POLISHED], by, params, progress)


def _polished(
    scene: Scene, model: Model, candidates: list[Fit], by: Judge, params: PoseParams, progress: Progress
) -> tuple[list[Fit], Doubles]:
    """Each candidate set by the outline where its surface is silent, then registered on all points."""
    polish = Registration(
        method=params.method, n_iterations=params.n_iterations,
        max_distance_mm=params.max_distance_mm / _POLISHED_SHARE, n_points=params.max_points,
    )  # fmt: skip
    few, middle = model.thinned(_FINE_MODEL), scene.points_mm.mean(axis=0)
    fits: list[Fit] = []
    placements: list[Doubles] = []
    for k, fit in enumerate(candidates):
        progress.step(0.7 + 0.2 * k / len(candidates), f"refining {k + 1} of {len(candidates)}")
        weak = _determined(scene, few, fit).weak_motions
        placements.append(placed(fit.sensor_from_object, weak, middle, _outline_judge(scene, model, fit, params)))
        fits.append(register(scene, model, placements[-1], polish))
    misfits_mm = by.misfit_mm([f.sensor_from_object for f in fits])
    order = np.argsort(misfits_mm, kind="stable")
    if params.keep_steps:
        # One iteration a call costs several times as much: only the winner is run again that way.
        progress.step(0.9, "keeping the iterations of the best")
        fits[order[0]] = register(scene, model, placements[order[0]], replace(polish, keep_steps=True))
    return [fits[k] for k in order], misfits_mm[order]


def _outline_judge(scene: Scene, model: Model, fit: Fit, params: PoseParams) -> Judge:
    """A judge on the part of the object around the contact, so that its points lie dense there."""
    part = in_reach(scene, model, fit.sensor_from_object, _OUTLINE_REACH_MM)
    return judge(scene, part, _FINE_FELT, _FINE_MODEL, params.max_distance_mm)


def _distinct(fits: list[Fit], by: Judge, scene: Scene) -> list[Fit]:
    """The fits from the best misfit on, without those that ended in the same place as a better one."""
    misfits_mm = by.misfit_mm([f.sensor_from_object for f in fits])
    middle = scene.points_mm.mean(axis=0)
    kept: list[Fit] = []
    for k in np.argsort(misfits_mm, kind="stable"):
        pose_k = fits[k].sensor_from_object
        if all(apart(pose_k, other.sensor_from_object, middle, _SAME_MM, _SAME_DEG) for other in kept):
            kept.append(fits[k])
    return kept


def _measured(fit: Fit, on: Surface, scene: Scene, params: PoseParams) -> Fit:
    """The fit with its residuals to the mesh itself: those to samples never come below the samples' spacing."""
    within_mm = params.max_distance_mm / _POLISHED_SHARE
    some = scene.points_mm[:: max(1, len(scene.points_mm) // _STEP_POINTS)]
    steps: list[PoseStep] = []
    for step in fit.steps:
        rmse_mm, fitness = on.residual(some, step.sensor_from_object, within_mm)
        steps.append(replace(step, rmse_mm=rmse_mm, fitness=fitness))
    rmse_mm, fitness = on.residual(scene.points_mm, fit.sensor_from_object, within_mm)
    return replace(fit, rmse_mm=rmse_mm, fitness=fitness, steps=tuple(steps))


def _answer(
    scene: Scene, model: Model, fits: list[Fit], misfits_mm: Doubles, n_tried: int, params: PoseParams
) -> ObjectPose:
    best = fits[0]
    known = _determined(scene, model, best)
    outline = _outline_judge(scene, model, best, params)
    points, pixel = _frozen(scene)
    return ObjectPose(
        sensor_from_object=freeze(best.sensor_from_object),
        covariance=freeze(known.covariance),
        observable=freeze(known.observable),
        weak=known.weak,
        rmse_mm=best.rmse_mm,
        fitness=best.fitness,
        scene_mm=points,
        source_index=pixel,
        steps=best.steps,
        starts_tried=n_tried,
        notes=(*_weak_notes(scene, best, known, outline), *_fit_notes(scene, fits, misfits_mm)),
    )


def _determined(scene: Scene, model: Model, fit: Fit) -> Observability:
    """From the object's normals where the scene lies on it, turned into the sensor frame."""
    from scipy.spatial import KDTree

    in_object = rigid.apply(rigid.invert(fit.sensor_from_object), scene.points_mm)
    near = in_reach(scene, model, fit.sensor_from_object, _OUTLINE_REACH_MM)
    _distance, index = KDTree(near.points_mm).query(in_object)
    normals = near.normals[index]
    residual = np.einsum("ij,ij->i", in_object - near.points_mm[index], normals)
    noise_mm = 1.4826 * float(np.median(np.abs(residual)))  # robust: the rim of a contact is not noise
    in_sensor = normals @ fit.sensor_from_object[:3, :3].T
    # On a flat face's rim the nearest sample may lie on the wall beside it, which was not felt and determines nothing.
    felt = np.einsum("ij,ij->i", in_sensor, scene.normals) > _SAME_SURFACE
    if felt.sum() < _MIN_POINTS:
        felt[:] = True
    return observability(scene.points_mm[felt], in_sensor[felt], scene.points_mm.mean(axis=0), noise_mm)


def _weak_notes(scene: Scene, fit: Fit, known: Observability, by: Judge) -> tuple[str, ...]:
    middle = scene.points_mm.mean(axis=0)
    return tuple(
        f"{words}: seen only by the outline of the contact"
        if shows(fit.sensor_from_object, motion, middle, by)
        else f"{words}: not observable"
        for words, motion in zip(known.weak, known.weak_motions, strict=True)
    )


def _fit_notes(scene: Scene, fits: list[Fit], misfits_mm: Doubles) -> tuple[str, ...]:
    notes: list[str] = []
    middle, best = scene.points_mm.mean(axis=0), fits[0].sensor_from_object
    limit_mm = misfits_mm[0] * (1 + _EQUAL_SHARE) + _EQUAL_MM
    equal = 1 + sum(
        bool(misfit <= limit_mm) and apart(fit.sensor_from_object, best, middle, _SAME_MM, _SAME_DEG)
        for fit, misfit in zip(fits[1:], misfits_mm[1:], strict=True)
    )
    if equal > 1:
        notes.append(f"{equal} poses fit equally well within {_EQUAL_SHARE:.0%}; the object may be symmetric")
    if fits[0].fitness < 0.5:
        notes.append(f"only {fits[0].fitness:.0%} of the contact lies on the object; the pose is doubtful")
    return tuple(notes)
