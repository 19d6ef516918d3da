"""A grasp between two fingers: the frames of all sensors, and the held pose as each touch shows
it.
"""

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from pipeline.core.geometry.meshes import Mesh
from pipeline.core.progress import SILENT, Progress, SubProgress
from pipeline.core.values.frames import Pairing, TactileFrame, Truth
from pipeline.lab.tasks.in_hand import (
    FINGERS,
    PlanarPose,
    estimate_grasp,
    press_between_fingers,
    project_to_plane,
)
from pipeline.lab.tasks.task import Attempt, Decision, Rollout, TrialPlan
from pipeline.lab.tasks.touches import (
    NONE,
    OWN,
    TRUE,
    Moment,
    correct_estimates,
    describe_decision,
    load_placed_sensor,
    make_pairing,
    place_sensor,
    share_error,
)
from pipeline.physics.simulation.poses import DEPTH_RANGE_MM, sample_press_pose
from pipeline.sensors.spec import SensorSpec

SOURCE = "gelslim"
TARGET = "soft_bubble"


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldObject:
    """An object between two fingers, with its touches."""

    mesh: Mesh
    held: PlanarPose  # hand_from_object, the truth
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
        part = 1.0 / len(values)
        maps = [
            moment.measure_depth(touch, one, SubProgress(progress, k * part, part, finger))
            for k, (moment, one, finger) in enumerate(
                zip(self.moments, values, FINGERS, strict=True)
            )
        ]
        return (
            estimate_grasp(maps, self.mesh, self.source if touch == OWN else self.target)
            or PlanarPose()
        )


def feel_grasp(
    plan: TrialPlan, mesh: Mesh, rng: np.random.Generator, progress: Progress = SILENT
) -> HeldObject:
    """Record a random grasp with the sensors that the plan needs: the target only for truth."""
    held = project_to_plane(sample_press_pose(mesh, rng, tilt_deg=0.0))
    indentation_mm = float(rng.uniform(*DEPTH_RANGE_MM))
    needs_target = plan.attribute or plan.record_frames or TRUE in plan.touches
    needs_source = plan.record_frames or any(touch not in (TRUE, NONE) for touch in plan.touches)
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
        pairings.append(make_pairing(finger, places[0].nominal, places[1].nominal))
        moments.append(Moment(mesh, recorded, places[0].nominal, places[1].nominal))
    return HeldObject(
        mesh=mesh,
        held=held,
        moments=tuple(moments),
        source=load_placed_sensor(SOURCE),
        target=load_placed_sensor(TARGET),
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
    rng = np.random.default_rng([plan.seed, zlib.crc32(case.encode()), plan.index])
    grasp = feel_grasp(plan, mesh, rng, SubProgress(progress, 0.0, 0.4, "touches"))

    def run_one(touch: str, own: Progress) -> Iterator[Rollout]:
        believed = grasp.estimate(
            touch, progress=SubProgress(own, 0.0, 0.3, "estimate of the grasp")
        )
        error_mm = measure_mm(grasp.held, believed)
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
            return measure_mm(grasp.held, corrected), attempt(
                grasp.held, corrected, tolerance_mm
            ).succeeds

        for tolerance_mm in plan.tolerances_mm:
            own.step(0.3, "rollout")
            done = attempt(grasp.held, believed, tolerance_mm)
            shares = ()
            if plan.attribute and not done.succeeds:
                shares = share_error(error_mm, correct(), partial(judge, tolerance_mm))
            decision = Decision(
                tick=0,
                error_mm=error_mm,
                estimate=believed.describe(),
                truth=grasp.held.describe(),
                shares=shares,
            )
            yield Rollout(
                case=case,
                trial=plan.index,
                touch=touch,
                tolerance_mm=tolerance_mm,
                succeeds=done.succeeds,
                cause=f"{done.cause}; {describe_decision(decision)}",
                measures=done.measures,
                decisions=(decision,),
                ticks=done.ticks,
                frames=grasp.frames,
                pairings=grasp.pairings,
                mesh=grasp.mesh,
            )

    part = 0.6 / len(plan.touches)
    return tuple(
        rollout
        for k, touch in enumerate(plan.touches)
        for rollout in run_one(touch, SubProgress(progress, 0.4 + k * part, part, touch))
    )
