"""Object touch: the object's mesh, registered on the source's depth, pressed into the target by the
simulator.

What the target touches outside the source's view, or deeper, is then the object's own shape. Other
poses that explain the source are pressed as well: their spread is the expected error of the touch.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pipeline.core.arrays import Doubles, Floats, freeze
from pipeline.core.errors import StageWarning, select_warnings
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.results import (
    DepthMap,
    GeneratedTouch,
    ObjectPose,
    PressedMembrane,
    TouchStep,
    make_depth_map,
)
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation.press import PressedSurface, press_membrane
from pipeline.sensors.alignment import Alignment
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.pose.registration.scene import list_starts
from pipeline.stages.pose.registration.search import SAME_MM, PoseSearch
from pipeline.stages.pose.signed_distances import (
    PoseParams,
    find_pose,
    prepare_search,
    refine_pose,
)
from pipeline.stages.pose.warm_start import FOLLOWED, move_along
from pipeline.stages.touch.membrane_fit import MembraneFit, fit_membrane, measure_residuals
from pipeline.stages.touch.object_posterior import PosePosterior, sample_poses

_DRAFT = 4.0  # times coarser: only the difference of a pose's touch from the best one's counts
# misfits: of 24 true poses 1.2 to 1.4, of wrong ones from 1.5
_EXPLAINED = 1.45
_MOST_NOISE = 3.0  # a larger misfit of a bubble refuses the mesh
# A larger misfit of a gel refuses the mesh. Chosen on half of 67 touches of random solids and tools
# by two gels. Of the others it accepts all true solids and 73 % of the true tools (of the rest the
# registered pose, or the depth of a flat face, is wrong), and refuses 66 % of wrong meshes, 18 % of
# those 15 % too large, and all in another unit, by the first pose alone. The poses compared before
# a refusal let pass 1 of 33 wrong meshes that it refuses, and 1 of 4 that are 15 % too large.
_MOST_ERROR = 1.1
# ratio of residuals that puts another pose first: a gel's depth has errors that a pose can explain
_CLEARLY = 0.85
_MAX_TIED = 7  # poses that fit a gel's contact equally well, compared by the whole gel
_MAX_PROMISING = 48  # distinct poses of a search, each pressed once
_MAX_OTHER_STARTS = 3  # each costs as much as the first
_UNSURE_SHARE = 0.3  # expected error over mean indentation from which on there is a warning
# Calibrated on 47 touches of random solids by nominal and by unlike sensors, so that about 90 % of
# the pixels in contact lie within the 90 % interval: 92 % from a GelSlim to a bubble, 91 % from a
# DIGIT to a GelSlim, 86 % from a bubble to a GelSlim.
_STD_FACTOR = 2.5  # of the poses' spread
_LEAST_STD = 0.006  # least standard deviation over the largest indentation
_BIAS_SHARE = 1.2  # of a gel's correlated depth error that moves the whole object
# mean absolute value of a normal error of standard deviation 1
_MEAN_FROM_STD = math.sqrt(2.0 / math.pi)


@frozen
class ObjectParams:
    """Settings of the posterior of the object's pose."""

    samples: int = setting(
        7,
        "Poses",
        unit="poses",
        low=1,
        high=64,
        step=1,
        help="poses drawn from those that explain the source; their spread is the expected error",
        source="Monte Carlo over the posterior of the pose",
    )
    seed: int = setting(
        0,
        "Seed",
        low=0,
        high=2**31 - 1,
        step=1,
        help="random seed of the poses",
        pinned="Seed",
        source="PCG64: O'Neill 2014 (numpy)",
    )
    keep_states: bool = setting(
        False,
        "Keep states",
        help="keep the touch of every pose for the step view; does not change the result",
        source="Tactoscope",
    )


def press_object(
    depth: DepthMap,
    source: SensorSpec,
    alignment: Alignment,
    target: SensorSpec,
    mesh: Mesh | None,
    previous: ObjectPose | None,
    params: ObjectParams,
    progress: Progress = SILENT,
) -> GeneratedTouch | str:
    """What `target` records of the object at the poses that explain the source's `depth`.

    The reason where none does.

    `previous` is the object's pose in the target frame on the frame before, from which it is
    tracked. Raises MeshProblem when the mesh has no surface, SettingProblem for a target without a
    simulator.
    """
    how = PoseParams(seed=params.seed)
    prepared = prepare_search(depth, mesh, how, SubProgress(progress, 0.0, 0.2))
    if isinstance(prepared, ObjectPose):
        return prepared.notes[0]
    search, mesh = prepared
    target_from_source = alignment.target_from_source
    if previous is not None and previous.sensor_from_object is not None:
        previous = _move_pose(previous, rigid.invert(target_from_source), source.camera)
    register = _register_contact if depth.measured_depth_mm is None else _register_membrane
    found = register(depth, source, search, mesh, previous, how, SubProgress(progress, 0.2, 0.5))
    pose = found.pose
    if pose.sensor_from_object is None:
        return pose.notes[0]
    if found.misfit > 1.0:
        return (
            f"the mesh does not fit: where it fits best, it is {found.misfit:.1f} times as far "
            "from the touch as the depth's own error allows; check the mesh and its unit"
        )
    posterior = sample_poses(search, pose, params.samples, params.seed)
    touch = _press_poses(
        posterior, target_from_source, target, mesh, found.bias_mm, params, progress
    )
    assert touch.membrane is not None
    membrane = replace(touch.membrane, error=depth.error)
    fields = {name: getattr(membrane, name) for name in DepthMap.__dataclass_fields__}
    object_pose = _move_pose(pose, target_from_source, target.camera)
    return replace(
        touch,
        membrane=PressedMembrane(**fields, object_pose=object_pose),
        notes=(*touch.notes, *select_warnings(pose.notes)),
    )


@frozen
class _Registered:
    """A pose in the source's frame and how far it explains the touch."""

    pose: ObjectPose
    misfit: float = 0.0  # more than 1: another object, or another size
    bias_mm: float = 0.0  # standard deviation of the whole object's depth


def _register_contact(
    depth: DepthMap,
    source: SensorSpec,
    search: PoseSearch,
    mesh: Mesh,
    previous: ObjectPose | None,
    how: PoseParams,
    progress: Progress,
) -> _Registered:
    """The pose on a gel's contact; of those that fit it equally well, the one that explains the
    whole gel.

    A depth that is far off ranks poses by chance, and a registration keeps a few. So before the
    mesh is refused, all that its search comes upon, and that fit the contact as well, are compared.
    """

    def compare(pose: ObjectPose) -> _Registered:
        assert pose.sensor_from_object is not None
        tied = (pose.sensor_from_object, *pose.alternatives[:_MAX_TIED])
        residuals = measure_residuals(depth, mesh, source, tied)
        rms_mm = np.array([residual.rms_mm for residual in residuals])
        order = np.argsort(rms_mm * ([_CLEARLY] + [1.0] * (len(tied) - 1)), kind="stable")
        best, *others = (tied[k] for k in order)
        return _Registered(
            pose=replace(pose, sensor_from_object=best, alternatives=tuple(others)),
            misfit=residuals[order[0]].misfit / _MOST_ERROR,
            bias_mm=0.0 if depth.error is None else _BIAS_SHARE * depth.error.rms_mm,
        )

    pose = find_pose(search, mesh, previous, how, progress)
    if pose.sensor_from_object is None:
        return _Registered(pose=pose)
    found = compare(pose)
    if found.misfit <= 1.0:
        return found
    progress.step(0.5, "comparing other poses by the whole gel")
    starts = list_starts(search.scene, search.object.model, "auto", how.n_starts)
    others = [
        other
        for other in search.find_promising(search.select_likeliest(starts), _MAX_PROMISING)
        if not search.fine.distinguishes(pose.sensor_from_object, other)
    ]
    residuals = measure_residuals(depth, mesh, source, others)
    fits = [k for k, residual in enumerate(residuals) if residual.misfit <= _MOST_ERROR]
    if not fits:
        return found
    least = min(fits, key=lambda k: residuals[k].rms_mm)
    other = refine_pose(search, others[least], progress)
    return found if other is None else min(found, compare(other), key=lambda one: one.misfit)


def _register_membrane(
    depth: DepthMap,
    source: SensorSpec,
    search: PoseSearch,
    mesh: Mesh,
    previous: ObjectPose | None,
    how: PoseParams,
    progress: Progress,
) -> _Registered:
    """The pose fitted to a bubble's whole membrane, from that of the previous touch where this
    explains it, else from the pose on the contact; where that does not, the best from others too.
    """

    def fit(start: Doubles) -> MembraneFit:
        return fit_membrane(depth, mesh, source, start, search.middle_mm, search.points.radius_mm)

    if previous is not None and previous.sensor_from_object is not None:
        before = previous.sensor_from_object
        followed = fit(before)
        after = followed.sensor_from_object
        others = move_along(search, previous.alternatives, before, after)
        is_near = search.measure_distance_mm(before, after) <= SAME_MM
        if others is not None and is_near and followed.misfit <= _EXPLAINED:
            pose = replace(previous, notes=tuple(dict.fromkeys((*previous.notes, FOLLOWED))))
            return _apply_fit(search, pose, followed, others)
    pose = find_pose(search, mesh, previous, how, progress)
    if pose.sensor_from_object is None:
        return _Registered(pose=pose)
    progress.step(0.5, "fitting the object to the whole membrane")
    best = fit(pose.sensor_from_object)
    for start in _list_other_starts(search, pose):
        if best.misfit <= _EXPLAINED:
            break
        best = min(best, fit(start), key=lambda one: one.misfit)
    moved = best.sensor_from_object @ rigid.invert(pose.sensor_from_object)
    return _apply_fit(search, pose, best, [moved @ other for other in pose.alternatives])


def _apply_fit(
    search: PoseSearch, pose: ObjectPose, fit: MembraneFit, others: Sequence[Doubles]
) -> _Registered:
    """A pose after a fit to the membrane, with the `others` that fit as well."""
    fitness, rmse_mm = search.measure_fit(fit.sensor_from_object)
    moved = replace(
        pose,
        sensor_from_object=fit.sensor_from_object,
        covariance=fit.covariance,
        alternatives=tuple(freeze(other) for other in others),
        rmse_mm=rmse_mm,
        fitness=fitness,
        scene_mm=search.scene.no_pose.scene_mm,
        source_index=search.scene.no_pose.source_index,
    )
    return _Registered(pose=moved, misfit=fit.misfit / _MOST_NOISE)


def _list_other_starts(search: PoseSearch, pose: ObjectPose) -> Iterator[Doubles]:
    """Poses that fit the contact as well, then others that its registration came upon."""
    yield from pose.alternatives[:_MAX_OTHER_STARTS]
    starts = list_starts(search.scene, search.object.model, "auto", PoseParams().n_starts)
    yield from search.find_promising(search.select_likeliest(starts))[:_MAX_OTHER_STARTS]


def _press_poses(
    posterior: PosePosterior,
    target_from_source: Doubles,
    target: SensorSpec,
    mesh: Mesh,
    bias_mm: float,
    params: ObjectParams,
    progress: Progress,
) -> GeneratedTouch:
    """The touch of the best pose, with the spread of the others as its expected error, and each
    of them if kept.
    """
    progress.step(0.7, "pressing the object into the target")
    modes, samples = (target_from_source @ poses for poses in (posterior.modes, posterior.samples))
    best = press_membrane(mesh, modes[0], target)
    touch = _make_membrane(target, target.rest_depth_mm - best.depth_mm, best.contact)
    first_mm = _press_draft(mesh, modes[0], target)
    square = np.zeros(target.camera.shape)
    for k, pose in enumerate(samples):
        progress.step(0.75 + 0.25 * k / len(samples), f"pose {k + 1} of {len(samples)}")
        square += (_press_draft(mesh, pose, target) - first_mm) ** 2 / len(samples)
    std_mm = np.sqrt(
        _STD_FACTOR**2 * square
        + (_LEAST_STD * np.abs(touch.indentation_mm).max()) ** 2
        + bias_mm**2
    )
    error_mm: Floats = (_MEAN_FROM_STD * std_mm).astype(np.float32)
    shape = target.camera.shape
    notes: list[str] = [
        f"{len(modes)} poses fit equally well" if len(modes) > 1 else "one pose fits"
    ]
    text = (
        f"expected error {float(error_mm.mean()):.2g} mm, from {len(samples)} poses that "
        "explain the source"
    )
    is_unsure = error_mm.mean() > _UNSURE_SHARE * np.abs(touch.indentation_mm).mean()
    notes.append(
        StageWarning(f"the source leaves the object's pose open: {text}") if is_unsure else text
    )
    if not best.converged:
        notes.append(
            StageWarning(
                "the simulated press did not converge: expect a wrong touch; check the alignment"
            )
        )
    return GeneratedTouch(
        image=_render(target, touch),
        camera=target.camera,
        source_index=freeze(np.full(shape, -1, np.int32)),
        in_view=freeze(np.ones(shape, np.bool_)),
        membrane=replace(touch, expected_error_mm=freeze(error_mm)),
        notes=tuple(notes),
        steps=tuple(
            _make_sample(press_membrane(mesh, pose, target), target)
            for pose in (*samples[::-1], *modes[::-1])
        )
        if params.keep_states
        else (),
    )


def _press_draft(mesh: Mesh, target_from_object: Doubles, target: SensorSpec) -> Floats:
    """The indentation by one pose at the target's pixels, computed on fewer."""
    import cv2

    small = target.with_camera(target.camera.scale(1.0 / _DRAFT))
    moved = small.rest_depth_mm - press_membrane(mesh, target_from_object, small).depth_mm
    return np.asarray(cv2.resize(moved.astype(np.float32), target.camera.shape[::-1]), np.float32)


def _make_sample(pressed: PressedSurface, target: SensorSpec) -> TouchStep:
    membrane = _make_membrane(target, target.rest_depth_mm - pressed.depth_mm, pressed.contact)
    return TouchStep(image=_render(target, membrane), sigma=math.nan, membrane=membrane)


def _make_membrane(target: SensorSpec, indentation_mm: Doubles, contact: np.ndarray) -> DepthMap:
    made = make_depth_map(
        target.rest_depth_mm, indentation_mm.astype(np.float32), contact, target.camera
    )
    return replace(made, is_generated=True)


def _render(target: SensorSpec, membrane: DepthMap) -> np.ndarray:
    return render_sensor_image(
        target, membrane.indentation_mm, membrane.depth_mm.astype(np.float64), None
    )


def _move_pose(pose: ObjectPose, by: Doubles, camera: Camera) -> ObjectPose:
    """A known pose and its alternatives in the frame of another sensor's camera."""
    assert pose.sensor_from_object is not None
    turn = np.kron(np.eye(2), by[:3, :3])  # of motions (rotation, translation)
    covariance, observable = (
        None if matrix is None else freeze(turn @ matrix @ turn.T)
        for matrix in (pose.covariance, pose.observable)
    )
    scene_mm = rigid.apply(by, pose.scene_mm)
    x_px, y_px, in_image = camera.project(scene_mm)
    pixel = np.rint(y_px) * camera.cols + np.rint(x_px)
    return replace(
        pose,
        sensor_from_object=freeze(by @ pose.sensor_from_object),
        covariance=covariance,
        observable=observable,
        scene_mm=freeze(scene_mm.astype(np.float32)),
        source_index=freeze(np.where(in_image, pixel, -1).astype(np.int32)),
        alternatives=tuple(freeze(by @ other) for other in pose.alternatives),
    )
