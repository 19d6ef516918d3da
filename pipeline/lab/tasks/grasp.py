"""A grasp between two fingers: the frames of all sensors, and the held pose as each touch shows
it, near the planned grasp.

Two parallel fingers leave an object three degrees of freedom: translation and rotation in their
plane. Each finger's touch is registered on the object's signed distances from starts over the range
of grasps; the finger that the object explains better counts more.
"""

import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from operator import itemgetter

import numpy as np

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.frames import Pairing, TactileFrame, Truth
from pipeline.core.values.results import DepthMap, ObjectPose
from pipeline.lab.tasks.task import (
    Attempt,
    Decision,
    Rollout,
    TrialPlan,
    describe_error,
    load_task,
)
from pipeline.lab.tasks.touches import (
    NONE,
    OWN,
    TRUE,
    CorrectedEstimate,
    Moment,
    correct_estimates,
    load_placed_sensor,
    make_pairing,
    place_sensor,
    share_error,
)
from pipeline.physics.simulation.poses import DEPTH_RANGE_MM, compute_lowest_mm, sample_press_pose
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.pose.registration.scene import InitialPose
from pipeline.stages.pose.registration.search import PoseSearch
from pipeline.stages.pose.signed_distances import PoseParams, prepare_search

FINGERS = ("left", "right")
# the right finger looks back at the left one
_FLIP: Doubles = freeze(rigid.rotation((math.pi, 0.0, 0.0)))
_DEG_PER_MM = 2.0  # rotation of a source that is off its described place
GRIP_MM = 0.6  # indentation that the controller expects
_OFFSETS_MM = (-5.0, -2.5, 0.0, 2.5, 5.0)  # starts over the grid of grasps
_ANGLES_DEG = tuple(range(-60, 61, 10))
# beyond these a pose is not one of the planned grasp
_MAX_ANGLE_DEG = 60.0
_MAX_OFFSET_MM = 9.0
# predicted error of a generated bubble up to which its pixels are used; a network outpaints the
# rest
_CERTAIN_MM = 0.5
# two fingers that differ by less are averaged
_AGREE_MM = 2.0
_AGREE_DEG = 10.0


@frozen
class PlanarPose:
    """hand_from_object in the fingers' plane; what is held may be tilted out of it."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)  # rotation vector in the fingers' plane

    @property
    def matrix(self) -> Doubles:
        """As (4, 4)."""
        tilted = rigid.translation(self.x_mm, self.y_mm, 0.0) @ rigid.rotation(
            (*self.tilt_rad, 0.0)
        )
        return tilted @ rigid.rotation((0.0, 0.0, self.angle_rad))

    def describe(self) -> dict[str, float]:
        """Its values in the plane by name, the angle in degrees."""
        return {"x_mm": self.x_mm, "y_mm": self.y_mm, "angle_deg": math.degrees(self.angle_rad)}


def parse_planar_pose(values: Mapping[str, float]) -> PlanarPose:
    """The pose that `describe` gave these values of; raises SettingProblem where one is missing."""
    try:
        x_mm, y_mm, angle_deg = (values[name] for name in ("x_mm", "y_mm", "angle_deg"))
    except KeyError as error:
        raise SettingProblem(
            f"a decision of the rollout has no {error}; run the task again"
        ) from error
    return PlanarPose(x_mm=x_mm, y_mm=y_mm, angle_rad=math.radians(angle_deg))


def project_to_plane(hand_from_object: Doubles) -> PlanarPose:
    """The planar part of a pose."""
    x, y = hand_from_object[:2, 3]
    angle = math.atan2(hand_from_object[1, 0], hand_from_object[0, 0])
    return PlanarPose(x_mm=float(x), y_mm=float(y), angle_rad=angle)


def press_between_fingers(
    mesh: Mesh, grasp: PlanarPose, finger: str, indentation_mm: float
) -> Doubles:
    """Return the pose (4, 4) of a grasped object for one finger, its deepest point `indentation_mm`
    into the gel.

    The pose maps object coordinates (mm) to the finger's alignment frame: z = 0 at the gel,
    pressing towards -z.
    """
    pose = (np.eye(4) if finger == "left" else _FLIP) @ grasp.matrix
    pose[2, 3] = -indentation_mm - compute_lowest_mm(
        rigid.apply(pose, mesh.vertices_mm), mesh.triangles
    )
    return pose


def estimate_grasp(
    touches: Sequence[DepthMap | None], mesh: Mesh, sensor: SensorSpec
) -> PlanarPose | None:
    """The grasp from one touch per finger in `sensor`'s frame.

    None where no finger has a usable touch.
    """
    found = [
        _estimate_by_finger(touch, mesh, sensor, finger)
        for touch, finger in zip(touches, FINGERS, strict=True)
        if touch is not None
    ]
    known = sorted((one for one in found if one is not None), key=itemgetter(1))
    if not known:
        return None
    values = np.array([(pose.x_mm, pose.y_mm, pose.angle_rad) for pose, _ in known])
    off = values - values[0]
    near = np.hypot(off[:, 0], off[:, 1]) < _AGREE_MM
    near &= np.abs(off[:, 2]) < math.radians(_AGREE_DEG)
    weights = near / np.array([max(misfit_mm, 1e-3) ** 2 for _, misfit_mm in known])
    x, y, angle = (weights @ values / weights.sum()).tolist()
    return PlanarPose(x_mm=x, y_mm=y, angle_rad=angle)


def _estimate_by_finger(
    touch: DepthMap, mesh: Mesh, sensor: SensorSpec, finger: str
) -> tuple[PlanarPose, float] | None:
    """The grasp as one finger sees it, and its misfit in mm."""
    prepared = prepare_search(_keep_certain(touch), mesh, PoseParams())
    if isinstance(prepared, ObjectPose):
        return None
    search: PoseSearch = prepared[0]
    hand_from_sensor = (np.eye(4) if finger == "left" else _FLIP) @ sensor.alignment_from_sensor
    starts: list[InitialPose] = []
    for k, angle in enumerate(_ANGLES_DEG):
        for x, y in product(_OFFSETS_MM, repeat=2):
            grasp = PlanarPose(x_mm=x, y_mm=y, angle_rad=math.radians(angle))
            in_finger = press_between_fingers(mesh, grasp, finger, GRIP_MM)
            pose = rigid.invert(sensor.alignment_from_sensor) @ in_finger
            starts.append(InitialPose(sensor_from_object=pose, group=("grasp", k)))
    minima = search.find_minima(search.find_promising(search.select_likeliest(starts)))
    for minimum in minima:
        pose = project_to_plane(hand_from_sensor @ minimum.fit.sensor_from_object)
        is_planned = max(abs(pose.x_mm), abs(pose.y_mm)) <= _MAX_OFFSET_MM
        if is_planned and abs(pose.angle_rad) <= math.radians(_MAX_ANGLE_DEG):
            return pose, minimum.misfit_mm
    return None


def _keep_certain(touch: DepthMap) -> DepthMap:
    """A generated touch where its predicted error is within the limit, or the better half of its
    contact.
    """
    if touch.expected_error_mm is None or not touch.is_generated or not touch.contact.any():
        return touch
    limit_mm = max(_CERTAIN_MM, float(np.nanmedian(touch.expected_error_mm[touch.contact])))
    known = np.nan_to_num(touch.expected_error_mm, nan=np.inf) <= limit_mm
    in_view = known if touch.in_view is None else touch.in_view & known
    return replace(touch, contact=freeze(touch.contact & known), in_view=freeze(in_view))


SOURCE = "gelslim"
TARGET = "soft_bubble"


@frozen
class HeldObject:
    """An object between two fingers, with its touches."""

    mesh: Mesh
    held: PlanarPose  # hand_from_object, the truth at the touch
    acted: PlanarPose  # the truth when the hand acts: after a slip
    moments: tuple[Moment, ...]  # of the left and the right finger
    source: SensorSpec
    target: SensorSpec
    frames: tuple[tuple[str, TactileFrame, Truth | None], ...]
    pairings: tuple[Pairing, ...]

    def estimate(
        self,
        touch: str,
        given: Sequence[dict[str, object]] | None = None,
        progress: Progress = SILENT,
    ) -> PlanarPose:
        """The held pose by a touch; as planned for "none" and where no finger has a usable touch.

        `given` holds values in place of stages, one mapping per finger.
        """
        if touch == NONE:
            return PlanarPose()
        values = given or [{} for _ in self.moments]
        maps = [
            moment.measure_depth(touch, one, SubProgress(progress, 0.5 * k, 0.5, FINGERS[k]))
            for k, (moment, one) in enumerate(zip(self.moments, values, strict=True))
        ]
        sensor = self.source if touch == OWN else self.target
        return estimate_grasp(maps, self.mesh, sensor) or PlanarPose()


def feel_grasp(plan: TrialPlan, mesh: Mesh, case: str, progress: Progress = SILENT) -> HeldObject:
    """Record a random grasp with the sensors that the plan needs: the target only for truth."""
    seeds = plan.seed, zlib.crc32(case.encode()), plan.index
    rng, draw = (np.random.default_rng(own) for own in (seeds, (*seeds, 1)))
    disturbed = plan.disturbance
    heading_rad, axis_rad = draw.uniform(0.0, 2.0 * math.pi, 2)
    tilt_rad = math.radians(disturbed.tilt)
    held = replace(
        project_to_plane(sample_press_pose(mesh, rng, tilt_deg=0.0)),
        tilt_rad=(tilt_rad * math.cos(axis_rad), tilt_rad * math.sin(axis_rad)),
    )
    slip_x_mm, slip_y_mm = (disturbed.slip * turn(heading_rad) for turn in (math.cos, math.sin))
    acted = replace(held, x_mm=held.x_mm + slip_x_mm, y_mm=held.y_mm + slip_y_mm)
    # the source is believed to be off its place by this
    shift, axis = (v / np.linalg.norm(v) for v in draw.standard_normal((2, 3)))
    moved = rigid.translation(*(disturbed.alignment * shift)) @ rigid.rotation(
        math.radians(_DEG_PER_MM * disturbed.alignment) * axis
    )
    indentation_mm = float(rng.uniform(*DEPTH_RANGE_MM))
    needs_target = plan.attribute or plan.record_frames or TRUE in plan.touches
    needs_source = plan.record_frames or any(touch not in (TRUE, NONE) for touch in plan.touches)
    described = load_placed_sensor(SOURCE)
    believed: Doubles = freeze(moved @ described.alignment_from_sensor)
    source = replace(described, alignment_from_sensor=believed)
    target = load_placed_sensor(TARGET)
    moments: list[Moment] = []
    frames: list[tuple[str, TactileFrame, Truth | None]] = []
    pairings: list[Pairing] = []
    for finger in FINGERS:
        # the same draws, whoever records
        places = [place_sensor(name, rng, plan.vary) for name in (SOURCE, TARGET)]
        pose = press_between_fingers(mesh, held, finger, indentation_mm)
        used = [
            place for place, need in zip(places, (needs_source, needs_target), strict=True) if need
        ]
        recorded: list[tuple[TactileFrame, Truth | None]] = []
        for place in used:
            progress.step(
                0.5 * FINGERS.index(finger) + 0.25 * len(recorded),
                f"{place.nominal.title}, {finger}",
            )
            recorded.append(place.record(mesh, pose, index=0, time_s=0.0))
        frames += [(f"{frame.sensor}_{finger}", frame, truth) for frame, truth in recorded]
        pairings.append(make_pairing(finger, source, target))
        moments.append(Moment(mesh, recorded, source, target))
    return HeldObject(
        mesh=mesh,
        held=held,
        acted=acted,
        moments=tuple(moments),
        source=source,
        target=target,
        frames=tuple(frames),
        pairings=tuple(pairings) if needs_source and needs_target else (),
    )


def run_through_touches(
    plan: TrialPlan,
    mesh: Mesh,
    case: str,
    measure_mm: Callable[[PlanarPose, PlanarPose], float],
    attempt: Callable[[PlanarPose, PlanarPose, float], Attempt],
    progress: Progress = SILENT,
) -> tuple[Rollout, ...]:
    """One rollout per touch and tolerance of a grasp of `mesh`, estimated through every touch.

    `attempt` acts on the held and the believed pose with a tolerance in mm, `measure_mm` is the
    belief's error.
    """
    grasp = feel_grasp(plan, mesh, case, SubProgress(progress, 0.0, 0.4, "touches"))
    title = load_task(plan.task).error_title

    def run_one(touch: str, own: Progress) -> Iterator[Rollout]:
        believed = grasp.estimate(
            touch, progress=SubProgress(own, 0.0, 0.3, "estimate of the grasp")
        )
        error_mm = measure_mm(grasp.acted, believed)
        correct = cache(
            partial(
                correct_estimates,
                grasp.moments,
                touch,
                partial(grasp.estimate, touch),
                grasp.held,
                progress=SubProgress(own, 0.3, 0.6, "attribution"),
            )
        )

        def judge(tolerance_mm: float, corrected: PlanarPose) -> tuple[float, bool]:
            own.step(0.9, "rollout with the truth")
            return measure_mm(grasp.acted, corrected), attempt(
                grasp.acted, corrected, tolerance_mm
            ).succeeds

        for tolerance_mm in plan.tolerances_mm:
            own.step(0.3, "rollout")
            done = attempt(grasp.acted, believed, tolerance_mm)
            shares = ()
            if plan.attribute and not done.succeeds:
                shares = share_error(error_mm, (*correct(), *slips), partial(judge, tolerance_mm))
            decision = Decision(
                tick=0,
                error_mm=error_mm,
                estimate=believed.describe(),
                truth=grasp.acted.describe(),
                shares=shares,
            )
            yield Rollout(
                case=case,
                trial=plan.index,
                touch=touch,
                tolerance_mm=tolerance_mm,
                succeeds=done.succeeds,
                cause=f"{done.cause}; {describe_error(decision, title, succeeds=False)}"
                if shares
                else done.cause,
                measures=done.measures,
                decisions=(decision,),
                ticks=done.ticks,
                frames=grasp.frames,
                pairings=grasp.pairings,
                mesh=grasp.mesh,
            )

    slips: tuple[CorrectedEstimate, ...] = ()
    if grasp.acted != grasp.held:
        slips = (CorrectedEstimate(stage="slip", title="slip", estimate=grasp.acted),)
    part = 0.6 / len(plan.touches)
    return tuple(
        rollout
        for k, touch in enumerate(plan.touches)
        for rollout in run_one(touch, SubProgress(progress, 0.4 + k * part, part, touch))
    )
