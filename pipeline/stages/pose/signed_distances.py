"""Pose: where the touched object is in the target sensor's frame (paper: ICP against the object's mesh).

A contact is a one-sided, partial view of the object, so a single registration ends in some minimum, confidently. Here
many first guesses are compared by what was felt and by what was not, the best are registered on the object's signed
distances, and what is left open is said: directions that nothing shows, and other poses that fit as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.base.arrays import Doubles, Floats, Indices, freeze
from pipeline.base.errors import SettingProblem
from pipeline.base.params import setting
from pipeline.base.progress import SILENT, Progress, SubProgress
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.registration.gauss_newton import CentredPoints, NotDetermined
from pipeline.registration.object_preparation import prepare_object
from pipeline.registration.planar_pose import estimate_planar_pose
from pipeline.registration.pose_selection import SelectedPose, select_pose
from pipeline.registration.scene import ContactScene, extract_scene
from pipeline.registration.search import PoseMinimum, PoseSearch
from pipeline.registration.starts import FACES, list_edge_starts, list_starts
from pipeline.stages.pose.icp import register_icp
from pipeline.values.results import DepthMap, ObjectPose

NO_CONTACT = "no contact: nothing was felt to find a pose from"
NO_MESH = "no object mesh was given; a pose needs one"
_MIN_POINTS = 20  # six unknowns, three times over
_MIN_FITNESS = 0.05  # share of the contact on the object below which there is no pose to speak of
_LARGEST = 100.0  # times the contact's size: a larger object's surface would be one plane


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseParams:
    """How the registration is done."""

    face: str = setting(
        "auto",
        "Face toward the sensor",
        choices=("auto", *FACES),
        help="axis of the object that points at the sensor",
        source="our own; the paper's evaluation knows it",
    )
    n_starts: int = setting(
        72, "Starts", unit="starts", low=1, high=1000, step=6, help="orientations that are tried",
        source="our own: turns about the normals of the object's faces",
    )  # fmt: skip
    n_iterations: int = setting(
        30, "Iterations", unit="iterations", low=1, high=200, step=5,
        help="of one registration at most; it ends sooner once it moves no more",
        source="Gauss-Newton with the weights of Geman and McClure 1985; ICP: Chen and Medioni 1992",
    )  # fmt: skip
    max_distance_mm: float = setting(
        2.0, "Search distance", unit="mm", low=0.05, high=20.0, step=0.1,
        help="points farther from the object do not count as on it",
        source="point to surface on signed distances; covariance: Bonnabel 2014",
    )  # fmt: skip
    max_points: int = setting(
        1500, "Points", unit="points", low=50, high=100_000, step=100, help="contact points that are used",
        source="our own: drawn evenly from the contact",
    )  # fmt: skip
    keep_steps: bool = setting(
        False, "Keep iterations", help="so that the way to the pose can be stepped through",
        source="our own; changes no answer",
    )  # fmt: skip
    seed: int = setting(
        0, "Seed", low=0, high=2**31 - 1, step=1, help="of the points that are drawn",
        source="PCG64: O'Neill 2014, as numpy has it",
    )  # fmt: skip


def estimate_pose(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose:
    """sensor_from_object (4, 4) in mm with its covariance and what it leaves open; None where it cannot be said.

    Raises MeshProblem when the mesh has no surface, SettingProblem for an unknown face.
    """
    ready = prepare_search(touch_depth, mesh, params, progress)
    return ready if isinstance(ready, ObjectPose) else _searched(*ready, params, progress, None)


def track_pose(
    touch_depth: DepthMap,
    mesh: Mesh | None,
    params: PoseParams,
    previous: Doubles,
    progress: Progress = SILENT,
    *,
    alternatives: Sequence[Doubles] = (),
) -> ObjectPose:
    """`pose` of the next touch of a sequence: followed from the `previous` sensor_from_object (4, 4) where that fits.

    `others` are the poses that fitted the last touch as well (`ObjectPose.alternatives`): they are followed too, so
    that a touch that tells them apart does. Where that leaves more than the depth's error explains, everything is
    searched anew. Of poses that fit equally well, the one nearest to `previous` is answered. Raises what `pose` does,
    CalibrationError when `previous` is no rigid transform.
    """
    ready = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(ready, ObjectPose):
        return ready
    search, checked = ready
    found = search.track_previous_poses(
        [rigid.validate_rigid(start, "the previous pose") for start in (previous, *alternatives)]
    )
    if found:
        told = _told(search, checked, found, 0, ("followed from the touch before",), previous, progress)
        return replace(told, steps=search.prepend_history(np.array([previous, *alternatives]), told.steps))
    return _searched(search, checked, params, progress, previous)


def estimate_or_track_pose(
    touch_depth: DepthMap,
    mesh: Mesh | None,
    previous: ObjectPose | None,
    params: PoseParams,
    progress: Progress = SILENT,
) -> ObjectPose:
    """The stage: `pose_from` where the touch before is given and has a pose, else `pose`."""
    if previous is None or previous.sensor_from_object is None:
        return estimate_pose(touch_depth, mesh, params, progress)
    return track_pose(
        touch_depth, mesh, params, previous.sensor_from_object, progress, alternatives=previous.alternatives
    )


def estimate_pose_planar(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose:
    """The pose by the paper's released planar evaluation, for comparison; raises what `pose` does."""
    ready = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(ready, ObjectPose):
        return ready
    search, checked = ready
    return estimate_planar_pose(
        search.scene, checked, search.object.model, params.face, params.n_iterations, keep_steps=params.keep_steps,
        progress=progress,
    )  # fmt: skip


def estimate_pose_icp(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose:
    """The pose by Open3D's point-to-plane ICP, the paper's own way; raises what `pose` does."""
    ready = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(ready, ObjectPose):
        return ready
    search, checked = ready
    return register_icp(
        search.scene, checked, search.object.model, face=params.face, n_starts=params.n_starts,
        n_iterations=params.n_iterations, max_distance_mm=params.max_distance_mm, seed=params.seed,
        keep_steps=params.keep_steps, progress=progress,
    )  # fmt: skip


def skip_pose(
    touch_depth: DepthMap,
    mesh: Mesh | None,
    previous: ObjectPose | None,  # noqa: ARG001 - a shortcut takes what its stage takes
    params: PoseParams,
) -> ObjectPose | None:
    """`without_contact` with the inputs of `posed`."""
    return skip_without_contact(touch_depth, mesh, params)


def skip_without_contact(touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams) -> ObjectPose | None:  # noqa: ARG001
    """The answer "unknown" when there is no mesh or no contact, else None; same inputs as `pose`."""
    if not touch_depth.contact.any():
        return _unknown(NO_CONTACT)
    return _unknown(NO_MESH) if mesh is None else None


def prepare_search(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose | tuple[PoseSearch, Mesh]:  # fmt: skip
    """What a search needs, or the answer where there is nothing to search."""
    early = skip_without_contact(touch_depth, mesh, params)
    if early is not None or mesh is None:
        return early or _unknown(NO_MESH)
    _check(params)
    scene = extract_scene(touch_depth, params.max_points, params.seed)
    few = f"only {len(scene.points_mm)} contact points show a surface; a pose needs at least {_MIN_POINTS}"
    if len(scene.points_mm) < _MIN_POINTS:
        return _unknown(few, scene)
    points = CentredPoints.from_points(scene.points_mm)
    if isinstance(points, NotDetermined):
        return _unknown(points.reason, scene)
    if len(mesh.vertices_mm) and _size_mm(mesh) > _LARGEST * points.radius_mm:
        return _unknown(_not_laid(mesh), scene)
    progress.step(0.0, "measuring the object")
    ready = prepare_object(mesh, params.seed, SubProgress(progress, 0.0, 0.2))
    return PoseSearch(
        scene=scene, points=points, object=ready, outward=FACES.get(params.face),
        max_distance_mm=params.max_distance_mm, n_iterations=params.n_iterations, keep_steps=params.keep_steps,
    ), mesh  # fmt: skip


def _check(params: PoseParams) -> None:
    if params.face not in ("auto", *FACES):
        raise SettingProblem(f"pose.face must be one of auto, {', '.join(FACES)}, got {params.face!r}")


def _searched(
    search: PoseSearch, mesh: Mesh, params: PoseParams, progress: Progress, near: Doubles | None
) -> ObjectPose:  # fmt: skip
    """The answer from all first guesses."""
    progress.step(0.2, "comparing first guesses")
    tried = list_starts(search.scene, search.object.model, params.face, params.n_starts)
    progress.step(0.21, "registering the most promising")
    firsts = search.select_likeliest(tried)
    found = search.find_minima(search.find_promising(firsts), SubProgress(progress, 0.3, 0.4))
    if not (found and search.explains(found[0])):
        progress.step(0.7, "comparing first guesses on edges and corners")
        further = list_edge_starts(search.scene, search.object.model, params.face, params.n_starts)
        edges = search.select_likeliest(further)
        more = search.find_minima(search.find_promising(edges), SubProgress(progress, 0.75, 0.25))
        firsts = np.concatenate([firsts, edges])
        tried, found = [*tried, *further], sorted([*found, *more], key=lambda m: m.misfit_mm)
    told = _told(search, mesh, found, len(tried), (), near, progress)
    return replace(told, steps=search.prepend_history(firsts, told.steps))


def _told(
    search: PoseSearch,
    mesh: Mesh,
    found: list[PoseMinimum],
    n_tried: int,
    notes: tuple[str, ...],
    near: Doubles | None,
    progress: Progress,
) -> ObjectPose:
    """The best of the minima, the others that fit as well, and what is not known; of equals, the one `near` a pose."""
    best = select_pose(search, found, progress)
    if best is None or best.minimum.fit.fitness < _MIN_FITNESS:
        return _unknown(_not_laid(mesh), search.scene)
    if near is not None and best.alternatives:
        equal = (best.minimum.fit.sensor_from_object, *best.alternatives)
        nearest = min(equal, key=lambda pose: search.measure_distance_mm(near, pose))
        other = None if nearest is equal[0] else search.polish(nearest, dense=True)
        best = (select_pose(search, [other, *found], progress) if other is not None else None) or best
    return _pose_of(search, best, n_tried, notes)


def _pose_of(search: PoseSearch, best: SelectedPose, n_tried: int, notes: tuple[str, ...]) -> ObjectPose:
    fit, known = best.minimum.fit, best.observability
    points, pixel = _frozen(search.scene)
    return ObjectPose(
        sensor_from_object=freeze(fit.sensor_from_object), covariance=freeze(known.covariance),
        observable=freeze(known.observable), weak_directions=known.weak_directions, rmse_mm=fit.rmse_mm, fitness=fit.fitness,
        scene_mm=points, source_index=pixel, steps=fit.steps, stop_reason=fit.stop_reason, starts_tried=n_tried,
        notes=(*best.notes, *search.object.grid.notes, *notes), alternatives=best.alternatives,
    )  # fmt: skip


def _unknown(why: str, scene: ContactScene | None = None) -> ObjectPose:
    points, pixel = _frozen(scene)
    return ObjectPose(
        sensor_from_object=None, covariance=None, observable=None, weak_directions=(), rmse_mm=math.nan, fitness=0.0,
        scene_mm=points, source_index=pixel, notes=(why,),
    )  # fmt: skip


def _not_laid(mesh: Mesh) -> str:
    return f"the object, {_size_mm(mesh):.3g} mm long, could not be laid on the contact; check the mesh's unit and face"


def _size_mm(mesh: Mesh) -> float:
    return float(np.ptp(mesh.vertices_mm, axis=0).max())


def _frozen(scene: ContactScene | None) -> tuple[Floats, Indices]:
    if scene is None:
        return freeze(np.empty((0, 3), dtype=np.float32)), freeze(np.empty(0, dtype=np.int32))
    return freeze(scene.points_mm.astype(np.float32)), freeze(scene.pixel)
