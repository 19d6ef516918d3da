"""Object pose in the target sensor's frame by registration on signed distances (paper: ICP against
the object's mesh).

A contact is a one-sided, partial view of the object, so a single registration converges to some
minimum. Here many starts are scored by contact and by free space, the best are registered on the
object's signed distances, and pose ambiguity is reported: unobservable directions, and other poses
that fit equally well.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import SettingProblem, describe_no_contact
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.results import DepthMap, ObjectPose, PressedMembrane
from pipeline.stages.pose.icp import register_icp
from pipeline.stages.pose.registration.gauss_newton import CentredPoints, NotDetermined
from pipeline.stages.pose.registration.model import prepare_object
from pipeline.stages.pose.registration.planar import estimate_planar_pose
from pipeline.stages.pose.registration.scene import (
    FACES,
    ContactScene,
    extract_scene,
    list_edge_starts,
    list_starts,
)
from pipeline.stages.pose.registration.search import (
    PoseMinimum,
    PoseSearch,
    SelectedPose,
    select_pose,
)
from pipeline.stages.pose.warm_start import FOLLOWED, follow_pose

_NO_POSE = "there is no pose"
NO_MESH = "no object mesh is given; a pose needs one"
PRESSED = "the pose at which the object was pressed into the target"
_MIN_POINTS = 20  # contact points, about three per unknown
_MIN_FITNESS = 0.05  # inlier share below which there is no pose
_MAX_SIZE_RATIO = 100.0  # object size over contact radius; a larger object would appear as a plane


@frozen
class PoseParams:
    """Settings of the registration."""

    face: str = setting(
        "auto",
        "Face toward the sensor",
        choices={"auto": "found by itself", **{face: f"{face} side" for face in FACES}},
        help="axis of the object that points toward the sensor",
        source="the paper's evaluation assumes it known",
    )
    n_starts: int = setting(
        72,
        "Starts",
        unit="starts",
        low=1,
        high=1000,
        step=6,
        help="initial orientations of the search",
        source="rotations about the normals of the object's faces",
    )
    n_iterations: int = setting(
        30,
        "Iterations",
        unit="iterations",
        low=1,
        high=200,
        step=5,
        help="limit of one registration, which stops earlier on convergence",
        source="Gauss-Newton with the weights of Geman and McClure 1985; ICP: Chen and Medioni "
        "1992",
    )
    max_distance_mm: float = setting(
        2.0,
        "Search distance",
        unit="mm",
        low=0.05,
        high=20.0,
        step=0.1,
        help="points farther from the object are outliers",
        source="point to surface on signed distances; covariance: Bonnabel 2014",
    )
    max_points: int = setting(
        1500,
        "Points",
        unit="points",
        low=50,
        high=100_000,
        step=100,
        help="number of contact points used",
        source="sampled evenly from the contact",
    )
    keep_steps: bool = setting(
        False,
        "Keep iterations",
        help="keep the iterations for the step view; does not change the result",
        source="Tactoscope",
    )
    seed: int = setting(
        0,
        "Seed",
        low=0,
        high=2**31 - 1,
        step=1,
        help="seed of the sampled points",
        source="PCG64: O'Neill 2014, as numpy has it",
    )


def estimate_pose(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose:
    """sensor_from_object (4, 4) in mm with covariance and pose ambiguity.

    None where it cannot be determined.

    Raises MeshProblem when the mesh has no surface, SettingProblem for an unknown face.
    """
    prepared = prepare_search(touch_depth, mesh, params, progress)
    return (
        prepared
        if isinstance(prepared, ObjectPose)
        else _search_pose(*prepared, params, progress, None)
    )


def track_pose(
    touch_depth: DepthMap,
    mesh: Mesh | None,
    params: PoseParams,
    previous: Doubles,
    progress: Progress = SILENT,
    *,
    alternatives: Sequence[Doubles] = (),
) -> ObjectPose:
    """Pose of the next touch of a sequence, tracked from the `previous` sensor_from_object (4, 4)
    where that fits.

    `alternatives` are the poses that fitted the last touch equally well
    (`ObjectPose.alternatives`); they are tracked too, so that a later touch can decide between
    them. Where the remaining misfit exceeds the depth error, the full search runs. Of equally good
    poses the one nearest to `previous` is returned. Raises as `estimate_pose` does, and
    CalibrationError when `previous` is not rigid.
    """
    prepared = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(prepared, ObjectPose):
        return prepared
    return _track_pose(*prepared, params, (previous, *alternatives), progress)


def estimate_or_track_pose(
    touch_depth: DepthMap,
    mesh: Mesh | None,
    previous: ObjectPose | None,
    params: PoseParams,
    progress: Progress = SILENT,
) -> ObjectPose:
    """The pose at which the object was pressed into the touch, else as `find_pose`."""
    if isinstance(touch_depth, PressedMembrane) and params == PoseParams():
        pose = touch_depth.object_pose
        return replace(pose, notes=tuple(dict.fromkeys((*pose.notes, PRESSED))))
    prepared = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(prepared, ObjectPose):
        return prepared
    return find_pose(*prepared, previous, params, progress)


def find_pose(
    search: PoseSearch,
    mesh: Mesh,
    previous: ObjectPose | None,
    params: PoseParams,
    progress: Progress = SILENT,
) -> ObjectPose:
    """The pose followed from that of the previous touch where it has one and that fits, else
    tracked from it, else searched.
    """
    if previous is None or previous.sensor_from_object is None:
        return _search_pose(search, mesh, params, progress, None)
    followed = follow_pose(search, previous, progress)
    if followed is not None:
        return _make_pose(search, followed, 0, (FOLLOWED,))
    before = (previous.sensor_from_object, *previous.alternatives)
    return _track_pose(search, mesh, params, before, progress)


def refine_pose(
    search: PoseSearch, start: Doubles, progress: Progress = SILENT
) -> ObjectPose | None:
    """The pose that a registration from near it converges to; None where that fails."""
    minimum = search.polish(start, dense=True)
    best = None if minimum is None else select_pose(search, [minimum], progress)
    return None if best is None else _make_pose(search, best, 1, ())


def _track_pose(
    search: PoseSearch,
    mesh: Mesh,
    params: PoseParams,
    before: Sequence[Doubles],
    progress: Progress,
) -> ObjectPose:
    """Pose tracked from the first of the poses `before`, or from one that fitted as well."""
    starts = [rigid.validate_rigid(start, "the previous pose") for start in before]
    minima = search.track_previous_poses(starts)
    if not minima:
        return _search_pose(search, mesh, params, progress, starts[0])
    notes = ("tracked from the pose of the previous touch",)
    pose = _select_answer(search, mesh, minima, 0, notes, starts[0], progress)
    return replace(pose, steps=search.prepend_history(np.array(starts), pose.steps))


def estimate_pose_planar(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose:
    """Pose by the paper's released planar evaluation, for comparison.

    Raises as `estimate_pose` does.
    """
    prepared = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(prepared, ObjectPose):
        return prepared
    return estimate_planar_pose(*prepared, params.face, progress)


def estimate_pose_icp(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose:
    """Pose by Open3D's point-to-plane ICP, as in the paper; raises as `estimate_pose` does."""
    prepared = prepare_search(touch_depth, mesh, params, progress)
    if isinstance(prepared, ObjectPose):
        return prepared
    return register_icp(*prepared, params.face, params.n_starts, params.seed, progress)


def skip_without_contact(touch_depth: DepthMap, mesh: Mesh | None, *_: object) -> ObjectPose | None:
    """The unknown pose if there is no mesh or no contact, else None, whatever else a method
    reads.
    """
    if not touch_depth.contact.any():
        return _make_unknown_pose(describe_no_contact(_NO_POSE, touch_depth.notes))
    return _make_unknown_pose(NO_MESH) if mesh is None else None


def prepare_search(
    touch_depth: DepthMap, mesh: Mesh | None, params: PoseParams, progress: Progress = SILENT
) -> ObjectPose | tuple[PoseSearch, Mesh]:
    """The prepared search and mesh, or the unknown pose where a search is impossible."""
    early = skip_without_contact(touch_depth, mesh)
    if early is not None or mesh is None:
        return early or _make_unknown_pose(NO_MESH)
    if params.face not in ("auto", *FACES):
        raise SettingProblem(
            f"pose.face must be one of auto, {', '.join(FACES)}, got {params.face!r}"
        )
    scene = extract_scene(touch_depth, params.max_points, params.seed)
    too_few = (
        f"only {len(scene.points_mm)} contact points have a surface normal; a pose needs "
        f"at least {_MIN_POINTS}"
    )
    if len(scene.points_mm) < _MIN_POINTS:
        return _make_unknown_pose(too_few, scene)
    points = CentredPoints.from_points(scene.points_mm)
    if isinstance(points, NotDetermined):
        return _make_unknown_pose(points.reason, scene)
    if len(mesh.vertices_mm) and _size_mm(mesh) > _MAX_SIZE_RATIO * points.radius_mm:
        return _make_unknown_pose(_explain_failure(mesh), scene)
    progress.step(0.0, "preparing the object")
    prepared = prepare_object(mesh, params.seed, SubProgress(progress, 0.0, 0.2))
    return PoseSearch(
        scene=scene,
        points=points,
        object=prepared,
        outward=FACES.get(params.face),
        max_distance_mm=params.max_distance_mm,
        n_iterations=params.n_iterations,
        keep_steps=params.keep_steps,
    ), mesh


def _search_pose(
    search: PoseSearch,
    mesh: Mesh,
    params: PoseParams,
    progress: Progress,
    near_pose: Doubles | None,
) -> ObjectPose:
    """Pose by the full search from all starts."""
    progress.step(0.2, "scoring starts")
    starts = list_starts(search.scene, search.object.model, params.face, params.n_starts)
    progress.step(0.21, "registering the best starts")
    first_poses = search.select_likeliest(starts)
    minima = search.find_minima(search.find_promising(first_poses), SubProgress(progress, 0.3, 0.4))
    if not (minima and search.explains(minima[0])):
        progress.step(0.7, "scoring starts on edges and corners")
        edge_starts = list_edge_starts(
            search.scene, search.object.model, params.face, params.n_starts
        )
        edges = search.select_likeliest(edge_starts)
        more = search.find_minima(search.find_promising(edges), SubProgress(progress, 0.75, 0.25))
        first_poses = np.concatenate([first_poses, edges])
        starts = [*starts, *edge_starts]
        minima = sorted([*minima, *more], key=lambda m: m.misfit_mm)
    pose = _select_answer(search, mesh, minima, len(starts), (), near_pose, progress)
    return replace(pose, steps=search.prepend_history(first_poses, pose.steps))


def _select_answer(
    search: PoseSearch,
    mesh: Mesh,
    minima: list[PoseMinimum],
    n_tried: int,
    notes: tuple[str, ...],
    near_pose: Doubles | None,
    progress: Progress,
) -> ObjectPose:
    """Pose of the best minimum with its ambiguity.

    Of equally good ones the one nearest to `near_pose`.
    """
    best = select_pose(search, minima, progress)
    if best is None or best.minimum.fit.fitness < _MIN_FITNESS:
        return _make_unknown_pose(_explain_failure(mesh), search.scene)
    if near_pose is not None and best.alternatives:
        equal = (best.minimum.fit.sensor_from_object, *best.alternatives)
        nearest = min(equal, key=lambda pose: search.measure_distance_mm(near_pose, pose))
        other = None if nearest is equal[0] else search.polish(nearest, dense=True)
        best = (
            select_pose(search, [other, *minima], progress) if other is not None else None
        ) or best
    return _make_pose(search, best, n_tried, notes)


def _make_pose(
    search: PoseSearch, best: SelectedPose, n_tried: int, notes: tuple[str, ...]
) -> ObjectPose:
    fit = best.minimum.fit
    known = best.observability
    return replace(
        search.scene.no_pose,
        sensor_from_object=freeze(fit.sensor_from_object),
        covariance=freeze(known.covariance),
        observable=freeze(known.observable),
        weak_directions=known.weak_directions,
        rmse_mm=fit.rmse_mm,
        fitness=fit.fitness,
        steps=fit.steps,
        stop_reason=fit.stop_reason,
        starts_tried=n_tried,
        notes=(*best.notes, *search.object.grid.notes, *notes),
        alternatives=best.alternatives,
    )


_NO_SCENE = ObjectPose(
    sensor_from_object=None,
    scene_mm=freeze(np.empty((0, 3), dtype=np.float32)),
    source_index=freeze(np.empty(0, dtype=np.int32)),
)


def _make_unknown_pose(why: str, scene: ContactScene | None = None) -> ObjectPose:
    return replace(_NO_SCENE if scene is None else scene.no_pose, notes=(why,))


def _explain_failure(mesh: Mesh) -> str:
    return (
        f"the object ({_size_mm(mesh):.3g} mm long) does not fit the contact; check unit of "
        "the mesh and face"
    )


def _size_mm(mesh: Mesh) -> float:
    return float(np.ptp(mesh.vertices_mm, axis=0).max())
