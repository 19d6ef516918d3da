"""Marble rolling: a gel plate rolls a marble from a random start to the centre of its view and
holds it there.

The controller is cloned on a GelSlim's images and reads a DIGIT through a translation (paper,
downstream tasks). Sizes, load, speeds, the expert and the network are not in the paper and are
chosen here.

A ball lies between a gel plate that moves in two slides and a cover that presses it onto the gel.
The plate's top is z = 0 of the world; the plate's frame has its axes and the centre of the gel as
origin. Without slip the ball follows the plate by half, so that it rolls by half the plate's motion
backwards over the gel.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Image
from pipeline.core.derived import derive_once
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.memo import memoise
from pipeline.core.params import setting
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.lab.tasks.scene import GRAVITY_MM_S2, Scene, write_box, write_pose
from pipeline.lab.tasks.scene_view import make_box
from pipeline.lab.tasks.task import (
    Decision,
    ManipulationTask,
    RecordedRollout,
    Rollout,
    SceneBody,
    TaskScene,
    Tick,
    TrialPlan,
    describe_error,
)
from pipeline.lab.tasks.touches import (
    NONE,
    OWN,
    TRUE,
    CorrectedEstimate,
    Moment,
    SensorPlace,
    list_true_stages,
    make_pairing,
    place_sensor,
    share_error,
)
from pipeline.lab.training.task import VALIDATION_SEED, Task, weigh_terms
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.shapes.solids import revolve_profile
from pipeline.stages.networks.network_factory import load_predictor
from pipeline.stages.networks.weights_registry import load_for_task

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

SOURCE = "digit"
TARGET = "gelslim"
N_TICKS = 60
# distance from the centre; both sensors see the whole contact
START_MM = (2.0, 3.7)
INDENTATION_MM = (0.3, 0.6)
# touches before a trial that show the DIGIT's LEDs
_CONTEXT_MM = ((2.0, 2.0), (-2.0, 2.0), (2.0, -2.0), (-2.0, -2.0))
RecordedFrame = tuple[TactileFrame, Truth | None]


@dataclass(frozen=True, kw_only=True)
class MarbleTrial:
    """What all touches of one trial share: the start, the load, and the sensor instances."""

    start_mm: tuple[float, float]
    indentation_mm: float
    source: SensorPlace
    target: SensorPlace

    @cached_property
    def load_n(self) -> float:
        """Force at which the target's gel is indented so far."""
        pose = rigid.translation(0.0, 0.0, RADIUS_MM - self.indentation_mm)
        return simulate_press(make_ball(), pose, self.target.nominal, seed=None).force_n

    @cached_property
    def context_images(self) -> tuple[Image, ...]:
        """Images of the source from before the trial."""
        poses = [rigid.translation(x, y, RADIUS_MM - self.indentation_mm) for x, y in _CONTEXT_MM]
        recorded = [
            self.source.record(make_ball(), pose, index=N_TICKS + k, time_s=0.0)
            for k, pose in enumerate(poses)
        ]
        return tuple(cast("Image", frame.image) for frame, _ in recorded)

    def start(self, replayed: Sequence[Doubles] = ()) -> RollingBall:
        """The ball at its start, or after these steps of the plate."""
        ball = RollingBall(self.start_mm, self.load_n)
        for step_mm in replayed:
            ball.move_plate(step_mm)
        return ball

    def record(self, sensor: str, ball: RollingBall, tick: int) -> RecordedFrame:
        """The frame of the source or the target at this tick."""
        pose = rigid.translation(0.0, 0.0, -self.indentation_mm) @ ball.plate_from_ball
        place = self.source if sensor == SOURCE else self.target
        return place.record(make_ball(), pose, index=tick, time_s=TICK_S * tick)

    def make_moment(self, frames: Sequence[RecordedFrame]) -> Moment:
        """One tick's frames as a moment that can be translated."""
        return Moment(
            make_ball(),
            frames,
            self.source.nominal,
            self.target.nominal,
            context_images=self.context_images,
            draft=True,
        )


def draw_trial(seed: int, index: int, vary: float) -> MarbleTrial:
    """Trial `index` of a seed."""
    rng = np.random.default_rng([seed, zlib.crc32(b"marble"), index])
    distance = rng.uniform(*START_MM)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    indentation = float(rng.uniform(*INDENTATION_MM))
    source, target = (place_sensor(name, rng, vary) for name in (SOURCE, TARGET))
    start = (float(distance * np.cos(angle)), float(distance * np.sin(angle)))
    return MarbleTrial(start_mm=start, indentation_mm=indentation, source=source, target=target)


# a glass marble of 16 mm, as the shape `marble`
RADIUS_MM = 8.0
BALL_KG = 0.0055
# of rubber on glass; rolling: torque over normal force
FRICTION = 0.6
SPIN_FRICTION_MM = 1.0
ROLLING_FRICTION_MM = 0.1
TICK_S = 0.1
_PLATE_KG = 0.2
_PLATE_STIFFNESS_N_M = 4000.0
_DAMPING_RATIO = 1.0
# halves of plate and cover
_PLATE_HALF_MM = 40.0
_COVER_HALF_MM = 60.0
_THICK_MM = 2.0
_LEAST_KG = 1e-4  # of a cover: MuJoCo wants one
_N_SIDES = 128  # of the mesh: chords within 3 um of the ball


@derive_once
def make_ball() -> Mesh:
    """The ball about its centre."""
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _N_SIDES // 2 + 1)
    return revolve_profile(
        RADIUS_MM * np.column_stack([np.cos(angle), np.sin(angle)]), _N_SIDES, "marble"
    )


class RollingBall:
    """A ball that starts at rest at a place on the plate, and the plate's slides."""

    def __init__(self, start_mm: tuple[float, float], load_n: float) -> None:
        """`start_mm` is the contact in the plate's frame, `load_n` the force of plate and ball
        on each other.
        """
        contact = (
            f'condim="6" friction="{FRICTION} {1e-3 * SPIN_FRICTION_MM} '
            f'{1e-3 * ROLLING_FRICTION_MM}"'
        )
        cover_kg = max(0.0, load_n / (1e-3 * GRAVITY_MM_S2) - BALL_KG)
        plate, cover = (
            write_box(
                (half, half, _THICK_MM),
                rigid.translation(0.0, 0.0, z),
                f'mass="{mass!r}" {contact}',
            )
            for half, z, mass in (
                (_PLATE_HALF_MM, -_THICK_MM, _PLATE_KG),
                (_COVER_HALF_MM, 2.0 * RADIUS_MM + _THICK_MM, max(cover_kg, _LEAST_KG)),
            )
        )
        damping = 2.0 * _DAMPING_RATIO * math.sqrt(_PLATE_STIFFNESS_N_M * _PLATE_KG)
        slides = "".join(
            f'<joint name="plate_{axis}" type="slide" axis="{vector}"/>' for axis, vector in _SLIDES
        )
        servos = "".join(
            f'<position name="plate_{axis}" joint="plate_{axis}" kp="{_PLATE_STIFFNESS_N_M}" '
            f'kv="{damping!r}"/>'
            for axis, _ in _SLIDES
        )
        self._scene = Scene(
            f'<body name="plate">{slides}{plate}</body>'
            f'<body name="ball" {write_pose(rigid.translation(*start_mm, RADIUS_MM))}><freejoint/>'
            f'<geom type="sphere" size="{1e-3 * RADIUS_MM}" mass="{BALL_KG}" {contact}/></body>'
            f'<body name="cover"><joint type="slide" axis="0 0 1"/>{cover}</body>',
            extra_xml=f"<actuator>{servos}</actuator>",
        )
        self._commanded_mm = np.zeros(2)

    @property
    def plate_from_ball(self) -> Doubles:
        """Pose (4, 4) of the ball's centre in the plate's frame."""
        return rigid.invert(self._scene.get_pose("plate")) @ self._scene.get_pose("ball")

    @property
    def contact_mm(self) -> Doubles:
        """(2,) where the ball touches the gel, in the plate's frame."""
        return self.plate_from_ball[:2, 3]

    def move_plate(self, step_mm: Doubles) -> Tick:
        """Move the plate by (2,) mm within one tick."""
        n_parts = 5
        for _ in range(n_parts):
            self._commanded_mm += step_mm / n_parts
            for (axis, _), value in zip(_SLIDES, self._commanded_mm, strict=True):
                self._scene.command(f"plate_{axis}", 1e-3 * float(value))
            self._scene.advance(TICK_S / n_parts)
        return Tick(
            time_s=self._scene.time_s,
            world_from_object=self._scene.get_pose("ball"),
            world_from_hand=self._scene.get_pose("plate"),
            commanded=rigid.translation(
                float(self._commanded_mm[0]), float(self._commanded_mm[1]), 0.0
            ),
            force_n=self._scene.measure_contact_force("ball", "plate"),
        )


_SLIDES = (("x", "1 0 0"), ("y", "0 1 0"))


EXPERT = "expert"
# of `pipeline.lab.training`; shipped
POLICY_TASK = "cloned_policy"
WEIGHTS = "marble_gelslim"
# of the policy's input
_ROWS = 48
_COLS = 64
N_HOLD_TICKS = 10
LOST_MM = 7.0  # from the centre: the contact is outside the view
# of the expert: plate's motion per tick over the ball's distance, and its limit
GAIN = 0.5
MAX_STEP_MM = 0.8
# halves of the gel that the target sees, and of the plate in the scene
_VIEW_HALF_MM = (9.0, 6.75)
_PLATE_MM = 1.0
_LAST_STAGE = "touch"  # that the controller reads


def command_as_expert(contact_mm: Doubles) -> Doubles:
    """The plate's step (2,) in mm that rolls a ball at `contact_mm` (2,) of the gel toward the
    centre.
    """
    return limit_step(GAIN * contact_mm)


def limit_step(step_mm: Doubles) -> Doubles:
    """A step of the plate, at most `MAX_STEP_MM` long."""
    return step_mm * min(1.0, MAX_STEP_MM / max(float(np.linalg.norm(step_mm)), 1e-9))


def shrink_image(image: np.ndarray[Any, Any]) -> Floats:
    """The policy's input (3, 48, 64) in shares of full brightness from an image (rows, cols, 3)
    of any size.
    """
    import cv2

    small = cv2.resize(image, (_COLS, _ROWS), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small.transpose(2, 0, 1)).astype(np.float32) / np.float32(255.0)


@frozen
class RollingRun:
    """What happened on one start by one touch; entry k of every list is tick k."""

    steps: list[Doubles] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    ticks: list[Tick] = field(default_factory=list)
    # of the contact from the centre, after each tick
    distances_mm: list[float] = field(default_factory=list)
    frames: list[tuple[str, TactileFrame, Truth | None]] = field(default_factory=list)


def roll(
    trial: MarbleTrial,
    touch: str,
    *,
    replayed: Sequence[Doubles] = (),
    n_true: int = 0,
    record: Sequence[str] = (),
) -> RollingRun:
    """Control the ball for `N_TICKS` by one touch, after the steps `replayed`.

    The first `n_true` stages of its translation are replaced by ground truth; `record` names
    sensors whose frames are kept although the controller does not read them.
    """
    ball = trial.start(replayed)
    sensors = list_read_sensors(touch, needs_truth=n_true > 0) | dict.fromkeys(record)
    run = RollingRun()
    for tick in range(len(replayed), len(replayed) + N_TICKS):
        recorded = {name: trial.record(name, ball, tick) for name in sensors}
        expert = command_as_expert(ball.contact_mm)
        step = choose_step(trial, touch, recorded, ball.contact_mm, n_true)
        run.steps.append(step)
        run.decisions.append(
            Decision(
                tick=tick,
                error_mm=float(np.linalg.norm(step - expert)),
                estimate=_describe(step),
                truth=_describe(expert),
            )
        )
        run.ticks.append(ball.move_plate(step))
        run.distances_mm.append(float(np.linalg.norm(ball.contact_mm)))
        run.frames.extend((f"{name}_plate", *recorded[name]) for name in record)
        if run.distances_mm[-1] > LOST_MM:
            break
    return run


def list_read_sensors(touch: str, *, needs_truth: bool = False) -> dict[str, None]:
    """The sensors whose frames a touch is made of, in order; with ground truth both."""
    if touch in (NONE, EXPERT):
        return {}
    if touch == TRUE:
        return {TARGET: None}
    return {SOURCE: None, TARGET: None} if needs_truth else {SOURCE: None}


def choose_step(
    trial: MarbleTrial,
    touch: str,
    recorded: Mapping[str, RecordedFrame],
    contact_mm: Doubles,
    n_true: int = 0,
) -> Doubles:
    """The plate's step by one touch; raises ModelMissing without the policy's weights."""
    if touch == NONE:
        return np.zeros(2)
    if touch == EXPERT:
        return command_as_expert(contact_mm)
    if touch == TRUE:
        image = recorded[TARGET][0].image
    elif touch == OWN:
        image = recorded[TARGET if n_true else SOURCE][0].image
    else:
        moment = trial.make_moment(
            [recorded[name] for name in list_read_sensors(touch, needs_truth=n_true > 0)]
        )
        steps = list_true_stages(moment, touch, _LAST_STAGE)[:n_true] if n_true else ()
        image = moment.generate_touch(touch, {stage: value for stage, _, value in steps}).image
    policy: Any = load_predictor(load_for_task(POLICY_TASK, WEIGHTS, None))
    return limit_step(np.asarray(policy(shrink_image(cast("Image", image)))[0], np.float64))


def attribute_worst_decision(
    trial: MarbleTrial, touch: str, run: RollingRun, tolerance_mm: float
) -> Decision:
    """The decision that is farthest from the expert's, with the shares of its error.

    Each share says whether the rollout, run again from that tick with the truth so far, succeeds.
    """
    worst = max(run.decisions, key=lambda decision: decision.error_mm)
    replayed = run.steps[: worst.tick]
    ball = trial.start(replayed)
    recorded = {name: trial.record(name, ball, worst.tick) for name in (SOURCE, TARGET)}
    titles = _list_titles(trial, touch, recorded)

    def judge(n_true: int) -> tuple[float, bool]:
        by = touch if n_true <= len(titles) else EXPERT
        step = choose_step(trial, by, recorded, ball.contact_mm, n_true)
        again = roll(trial, by, replayed=replayed, n_true=n_true if by == touch else 0)
        error_mm = float(np.linalg.norm(step - command_as_expert(ball.contact_mm)))
        return error_mm, is_held(again, tolerance_mm)

    corrected = [
        CorrectedEstimate(stage=stage, title=title, estimate=n)
        for n, (stage, title) in enumerate((*titles, ("policy", "policy")), start=1)
    ]
    return replace(worst, shares=share_error(worst.error_mm, corrected, judge))


def _list_titles(
    trial: MarbleTrial, touch: str, recorded: Mapping[str, RecordedFrame]
) -> tuple[tuple[str, str], ...]:
    """(stage, title) of what ground truth can replace before the policy."""
    if touch in (NONE, TRUE, EXPERT):
        return ()
    if touch == OWN:
        return (("touch", "missing translation"),)
    moment = trial.make_moment(list(recorded.values()))
    return tuple((stage, title) for stage, title, _ in list_true_stages(moment, touch, _LAST_STAGE))


def is_held(run: RollingRun, tolerance_mm: float) -> bool:
    """Whether the ball was within the tolerance of the centre during the last ticks."""
    return len(run.steps) == N_TICKS and measure_held_mm(run) <= tolerance_mm


def measure_held_mm(run: RollingRun) -> float:
    """Largest distance of the contact from the centre in the last ticks."""
    return max(run.distances_mm[-N_HOLD_TICKS:])


def run_trial(plan: TrialPlan, progress: Progress = SILENT) -> Iterator[Rollout]:
    """One start, rolled by every touch and judged by every tolerance."""
    trial = draw_trial(plan.seed, plan.index, plan.vary)
    pairing = make_pairing("plate", trial.source.nominal, trial.target.nominal)
    for done, touch in enumerate(plan.touches):
        progress.step(done / len(plan.touches), f"rollout by {touch}")
        record: tuple[str, ...] = ()
        if plan.record_frames:
            record = (TARGET,) if touch == EXPERT else (SOURCE, TARGET)
        run = roll(trial, touch, record=record)
        for tolerance_mm in plan.tolerances_mm:
            succeeds = is_held(run, tolerance_mm)
            decisions = list(run.decisions)
            cause = _describe_end(run, tolerance_mm)
            if plan.attribute and not succeeds:
                worst = attribute_worst_decision(trial, touch, run, tolerance_mm)
                decisions[worst.tick] = worst
                cause += (
                    f"; worst command {TICK_S * worst.tick:.1f} s after the start, "
                    f"{describe_error(worst, TASK.error_title, succeeds=False)}"
                )
            yield Rollout(
                case=plan.case,
                trial=plan.index,
                touch=touch,
                tolerance_mm=tolerance_mm,
                succeeds=succeeds,
                cause=cause,
                measures={"end_mm": run.distances_mm[-1], "held_mm": measure_held_mm(run)},
                decisions=tuple(decisions),
                ticks=tuple(run.ticks),
                frames=tuple(run.frames),
                pairings=(pairing,) if len(record) > 1 else (),
                mesh=make_ball(),
            )


def _describe_end(run: RollingRun, tolerance_mm: float) -> str:
    if run.distances_mm[-1] > LOST_MM:
        return f"rolls out of view {TICK_S * len(run.steps):.1f} s after the start"
    held_mm = measure_held_mm(run)
    return f"{'held' if held_mm <= tolerance_mm else 'ends'} within {held_mm:.1f} mm of the centre"


def _describe(step_mm: Doubles) -> dict[str, float]:
    return {"x_mm": float(step_mm[0]), "y_mm": float(step_mm[1])}


def build_scene(_rollout: RecordedRollout) -> TaskScene:
    """The gel plate under the ball, as large as the target's view."""
    plate = make_box((*_VIEW_HALF_MM, _PLATE_MM), "gel plate", (0.0, 0.0, -_PLATE_MM))
    return TaskScene(bodies=(SceneBody(name="gel plate", mesh=plate, parent="hand"),))


TASK = ManipulationTask(
    name="marble",
    title="Marble rolling",
    source=SOURCE,
    target=TARGET,
    cases=("marble",),
    touches=(TRUE, "t2d2", OWN),
    further_touches=(EXPERT,),
    tolerances_mm=(1.0,),
    error_title="from the expert's step",
    build_scene=build_scene,
    tolerance_title="held within, mm",
    n_trials=20,
    run=run_trial,
    published={("marble", TRUE): "20/20", ("marble", "t2d2"): "15/20"},
)


_MAX_BYTES = 2 << 30  # of the demonstrations at hand
_DEMONSTRATION_SEED = 1
_NOISE_MM = 0.5  # deviation of the plate's steps from the expert's


@frozen
class ClonedPolicyTask(Task):
    """Settings of the demonstrations: a controller copies the scripted expert (behaviour cloning).

    The expert knows where the ball is. Its demonstrations are what the target sensor records
    meanwhile; noise on the motion that is carried out, and not on the expert's command, leads to
    places that the network will visit by its own errors.
    """

    n_demonstrations: int = setting(
        160, "Demonstrations", low=1, high=100_000, help="each with another sensor instance"
    )
    n_ticks: int = setting(25, "Ticks", low=1, high=1000, help="of each demonstration")

    def sample(self, rng: np.random.Generator) -> Example:
        """An image of the target and the expert's step."""
        index = int(rng.integers(self.n_demonstrations))
        tick = int(rng.integers(self.n_ticks))
        return self._make_example(_DEMONSTRATION_SEED, index, tick)

    def make_validation_example(self, split: Split, index: int) -> Example:  # noqa: ARG002 - only new starts
        """A moment of a new demonstration."""
        return self._make_example(VALIDATION_SEED, *divmod(index, self.n_ticks))

    def count_validation_examples(self, split: Split) -> int:
        """There are no unseen objects."""
        return 1 << 30 if split == "unseen_grasps" else 0

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """Mean distance of the steps, in mm."""
        error = (network(batch["image"]) - batch["step"]).square().sum(1)
        return weigh_terms({"step error, mm": (1.0, (error + 1e-4).sqrt().mean())})

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Distance of the steps from the expert's."""
        import torch

        with torch.inference_mode():
            steps = network(torch.from_numpy(np.stack([one["image"] for one in held_out]))).numpy()
        error = np.linalg.norm(steps - np.stack([one["step"] for one in held_out]), axis=1)
        return {"step error, mm": float(error.mean())}

    def _make_example(self, seed: int, index: int, tick: int) -> Example:
        images, steps = demonstrate(seed, index, self.n_ticks)
        return {"image": images[tick], "step": steps[tick]}


@memoise(1 << 16, most_bytes=_MAX_BYTES)
def demonstrate(seed: int, index: int, n_ticks: int) -> tuple[Floats, Floats]:
    """Images (n, 3, 48, 64) of the target and the expert's steps (n, 2) in mm of one
    demonstration.
    """
    trial = draw_trial(seed, index, 1.0)
    rng = np.random.default_rng([seed, index])
    ball = trial.start()
    images = []
    steps = []
    for tick in range(n_ticks):
        step = command_as_expert(ball.contact_mm)
        frame, _ = trial.record(TARGET, ball, tick)
        images.append(shrink_image(cast("Image", frame.image)))
        steps.append(step.astype(np.float32))
        ball.move_plate(step + _NOISE_MM * rng.normal(size=2))
    return np.stack(images), np.stack(steps)
