"""Cup stacking: a cup that two fingers hold by its rim is turned upright over a standing one,
lowered and released.

The fingers touch a piece of the rim from inside and outside. Size, taper, weight and friction of
the cups are not in the paper and are chosen here. Cups are tapered rings of flat walls with a
bottom.
"""

import math

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.derived import derive_once
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.progress import SILENT, Progress
from pipeline.lab.tasks.grasp import (
    SOURCE,
    TARGET,
    PlanarPose,
    parse_planar_pose,
    run_through_touches,
)
from pipeline.lab.tasks.scene import Scene, write_box, write_pose
from pipeline.lab.tasks.scene_view import list_angles, make_fingers, make_ring
from pipeline.lab.tasks.task import (
    Attempt,
    ManipulationTask,
    RecordedRollout,
    Rollout,
    SceneBody,
    TaskScene,
    Tick,
    TrialPlan,
)
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.shapes.solids import transform_mesh

# radius of the rim's middle, as of the shape `cup_rim`; height; thickness
RIM_MM = 40.0
HEIGHT_MM = 60.0
WALL_MM = 2.4
GRIP_BELOW_MM = 4.5  # the fingers' centre below the rim's crest
CUP_KG = 0.03
FRICTION = 0.3
N_WALLS = 16
TICK_S = 0.04
SPEED_MM_S = 60.0
SETTLE_S = 0.8
# height of the bottom above the standing rim; above the nested position
START_MM = 15.0
RELEASE_MM = 12.0
# of a nested cup
MAX_TILT_DEG = 5.0
MAX_OFF_MM = 5.0
MAX_HIGH_MM = 6.0
_RIM_FROM_SHAPE: Doubles = rigid.translation(GRIP_BELOW_MM, 0.0, 0.0) @ rigid.rotation(
    (0.0, -0.5 * math.pi, 0.0)
)
# The rim's +x, its crest, is up; its +z, outward, is the cup's x.
_CUP_FROM_RIM: Doubles = np.array(
    [
        [0.0, 0.0, 1.0, RIM_MM],
        [0.0, -1.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, HEIGHT_MM - GRIP_BELOW_MM],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


@derive_once
def make_rim() -> Mesh:
    """The piece of a rim between the fingers: +x to its crest, z along the fingers' normal."""
    return transform_mesh(shapes.make_shape("cup_rim").mesh, _RIM_FROM_SHAPE)


def compute_nested_mm(clearance_mm: float) -> float:
    """How much higher a nested cup stands: walls of thickness t and slope s touch t / s higher."""
    return WALL_MM * HEIGHT_MM / (WALL_MM + clearance_mm)


def write_cup(clearance_mm: float) -> str:
    """MJCF geoms of a cup whose bottom is narrower than the inside of its rim by `clearance_mm`
    in radius.
    """
    bottom_mm = RIM_MM - WALL_MM - clearance_mm
    slope = math.atan2(RIM_MM - bottom_mm, HEIGHT_MM)
    middle = 0.5 * (RIM_MM + bottom_mm)
    half = (0.5 * WALL_MM, RIM_MM * math.tan(math.pi / N_WALLS), 0.5 * HEIGHT_MM / math.cos(slope))
    attributes = f'friction="{FRICTION}" mass="{CUP_KG / (N_WALLS + 1)}"'
    walls = [
        write_box(
            half,
            rigid.rotation((0.0, 0.0, 2.0 * math.pi * k / N_WALLS))
            @ rigid.translation(middle, 0.0, 0.5 * HEIGHT_MM)
            @ rigid.rotation((0.0, slope, 0.0)),
            attributes,
        )
        for k in range(N_WALLS)
    ]
    radius = 1e-3 * bottom_mm
    thick = 1e-3 * 0.5 * WALL_MM
    walls.append(f'<geom type="cylinder" size="{radius} {thick}" pos="0 0 {thick}" {attributes}/>')
    return "".join(walls)


def place_cup(held: PlanarPose, believed: PlanarPose, height_mm: float) -> Doubles:
    """world_from_cup of the held cup when the hand believes to hold it upright over the origin
    at a height.
    """
    upright = rigid.translation(0.0, 0.0, height_mm) @ _CUP_FROM_RIM
    return upright @ rigid.invert(believed.matrix) @ held.matrix @ rigid.invert(_CUP_FROM_RIM)


def measure_off_mm(held: PlanarPose, believed: PlanarPose) -> float:
    """How far the centre of the held cup's bottom is from where the hand believes it."""
    return float(np.linalg.norm(place_cup(held, believed, 0.0)[:3, 3]))


def stack(held: PlanarPose, believed: PlanarPose, clearance_mm: float) -> Attempt:
    """Lower and release a cup held at `held` as if it were held at `believed`.

    Judge it when it has settled.
    """
    nested_mm = compute_nested_mm(clearance_mm)
    top_mm = HEIGHT_MM + START_MM
    end_mm = nested_mm + RELEASE_MM
    start = place_cup(held, believed, top_mm)
    cup = write_cup(clearance_mm)
    scene = Scene(
        f'<geom type="plane" size="1 1 1" friction="{FRICTION}"/>'
        f'<body name="standing"><freejoint/>{cup}</body>'
        f'<body name="hand" mocap="true" {write_pose(start)}/>'
        f'<body name="cup" {write_pose(start)}><freejoint/>{cup}</body>',
        extra_xml='<equality><weld name="grip" body1="hand" body2="cup" solref="0.02 '
        '1"/></equality>',
    )
    ticks: list[Tick] = []

    def step(commanded: Doubles) -> None:
        scene.move_mocap("hand", commanded)
        scene.advance(TICK_S)
        ticks.append(
            Tick(
                time_s=TICK_S * (len(ticks) + 1),
                world_from_object=scene.get_pose("cup"),
                commanded=commanded,
                world_from_hand=scene.get_pose("hand"),
                force_n=scene.measure_contact_force("cup"),
                world_from_bodies={"standing": scene.get_pose("standing")},
            )
        )

    lowered = 0.0
    while lowered < top_mm - end_mm:
        lowered = min(lowered + SPEED_MM_S * TICK_S, top_mm - end_mm)
        step(rigid.translation(0.0, 0.0, -lowered) @ start)
    commanded = ticks[-1].commanded
    scene.release("grip")
    for _ in range(round(SETTLE_S / TICK_S)):
        step(commanded)
    return _judge_stack(ticks, scene.get_pose("standing"), nested_mm)


def _judge_stack(ticks: list[Tick], standing: Doubles, nested_mm: float) -> Attempt:
    cup = ticks[-1].world_from_object
    tilt_deg = max(math.degrees(math.acos(min(1.0, float(pose[2, 2])))) for pose in (cup, standing))
    off_mm = float(np.linalg.norm(cup[:2, 3] - standing[:2, 3]))
    high_mm = float(cup[2, 3] - standing[2, 3]) - nested_mm
    nested = off_mm <= MAX_OFF_MM and abs(high_mm) <= MAX_HIGH_MM
    if tilt_deg > MAX_TILT_DEG:
        cause = f"a cup is tilted by {tilt_deg:.0f} degrees"
    else:
        cause = (
            "upright and nested" if nested else f"upright but {high_mm:.0f} mm higher than nested"
        )
    return Attempt(
        ticks=tuple(ticks),
        succeeds=nested and tilt_deg <= MAX_TILT_DEG,
        cause=cause,
        measures={"tilt_deg": tilt_deg, "off_mm": off_mm, "above_nested_mm": high_mm},
    )


def run(plan: TrialPlan, progress: Progress = SILENT) -> tuple[Rollout, ...]:
    """One grasp of a rim, estimated through every touch, stacked with every clearance."""
    return run_through_touches(plan, make_rim(), plan.case, measure_off_mm, stack, progress)


def make_cup(clearance_mm: float) -> Mesh:
    """The cup of `write_cup` as one mesh."""
    bottom_mm = RIM_MM - WALL_MM - clearance_mm
    half = 0.5 * WALL_MM
    profile = (
        (np.array(bottom_mm + half), 0.0),
        (np.array(RIM_MM + half), HEIGHT_MM),
        (np.array(RIM_MM - half), HEIGHT_MM),
        (np.array(bottom_mm - half), WALL_MM),
        (np.array(0.0), WALL_MM),
        (np.array(0.0), 0.0),
    )
    return make_ring(profile, list_angles(N_WALLS), "cup")


def build_scene(rollout: RecordedRollout) -> TaskScene:
    """The standing cup, and both fingers at the rim of the held one."""
    first = rollout.summary.decisions[0]
    cup = make_cup(rollout.summary.tolerance_mm)
    held = parse_planar_pose(first.truth)
    # the hand of a tick is the frame of the held cup
    cup_from_fingers = _CUP_FROM_RIM @ rigid.invert(held.matrix)
    return TaskScene(
        bodies=(
            SceneBody(name="standing cup", mesh=cup, parent="standing"),
            *make_fingers(make_rim(), held, cup_from_fingers),
        ),
        hand_from_estimate=lambda decision: rigid.invert(
            place_cup(held, parse_planar_pose(decision.estimate), 0.0)
        ),
        object_mesh=cup,
    )


TASK = ManipulationTask(
    name="stack",
    title="Cup stacking",
    source=SOURCE,
    target=TARGET,
    cases=("cup",),
    touches=("t2t", "vqvae", "true", "none"),
    tolerances_mm=(2.0, 4.0, 8.0),
    tolerance_title="clearance in radius, mm",
    n_trials=30,
    run=run,
    holds_object=True,
    error_title="off the cup's axis",
    build_scene=build_scene,
    published={("cup", "t2t"): "22/30", ("cup", "vqvae"): "21/30"},
)
