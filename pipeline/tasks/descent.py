"""The compliant descent of a held peg into its hole."""

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.tasks.peg import Peg, write_hole
from pipeline.tasks.scene import Scene, write_compliant_joints, write_pose
from pipeline.tasks.task import Attempt, Tick

TICK_S = 0.02
STIFFNESS_N_MM, STIFFNESS_NMM_RAD, HAND_KG = 2.0, 2000.0, 0.5  # of the hand's impedance control
SPEED_MM_S, START_MM = 30.0, 15.0  # of the descent, and the tip's height at its start if the belief is true
BEYOND_MM = 4.0  # commanded beyond the full depth, for a tip that is shorter than believed
SETTLE_S = 0.2
SHORT_MM = 0.3  # of the full depth that still counts
WORLD_FROM_UPRIGHT: Doubles = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""A tool over its hole: its x points down, its z, the normal of the fingers, along the world's y."""


def insert(
    peg: Peg,
    hand_from_tool: Doubles,
    believed: Doubles,
    *,
    clearance_mm: float,
    lead_in_mm: float,
    force_limit_n: float,
) -> Attempt:
    """Lower a tool that the hand holds at `hand_from_tool` as if it held it at `believed` (4, 4)."""
    joints, actuators = write_compliant_joints("hand", STIFFNESS_N_MM, STIFFNESS_NMM_RAD, HAND_KG)
    above = WORLD_FROM_UPRIGHT @ rigid.translation(-peg.tip_mm - START_MM, 0.0, 0.0)
    world_from_hand = above @ rigid.invert(believed)  # at the joints' zero
    turned = world_from_hand.copy()
    turned[:3, 3] = 0.0
    # The joints move along the world's axes, the hand is turned inside.
    start = rigid.translation(*world_from_hand[:3, 3])
    body = (
        f'<body name="hand" gravcomp="1" {write_pose(start)}>{joints}'
        f'<inertial pos="0 0 0" mass="{HAND_KG}" diaginertia="2e-4 2e-4 2e-4"/>'
        f'<geom type="mesh" mesh="peg" friction="0.3" mass="0" {write_pose(turned @ hand_from_tool)}/></body>'
    )
    scene = Scene(
        write_hole(peg, clearance_mm, lead_in_mm) + body, extra_xml=actuators, meshes_mm={"peg": peg.points_mm}
    )
    ticks: list[Tick] = []
    full_mm = START_MM + peg.depth_mm + BEYOND_MM
    largest, cause, depth = 0.0, "", -START_MM
    n_ticks = round((full_mm / SPEED_MM_S + SETTLE_S) / TICK_S)
    for tick in range(n_ticks):
        lowered = min(full_mm, SPEED_MM_S * TICK_S * (tick + 1))
        scene.command("hand_z", -1e-3 * lowered)
        scene.advance(TICK_S)
        hand, force = scene.get_pose("hand") @ turned, scene.measure_contact_force("hand")
        world_from_tool = hand @ hand_from_tool
        depth = -float(rigid.apply(world_from_tool, (peg.tip_mm, 0.0, 0.0))[2])
        ticks.append(Tick(
            time_s=TICK_S * (tick + 1), world_from_object=world_from_tool, world_from_hand=hand,
            commanded=rigid.translation(0.0, 0.0, -lowered) @ world_from_hand, force_n=force,
        ))  # fmt: skip
        largest = max(largest, float(np.linalg.norm(force)))
        if largest > force_limit_n:
            cause = f"jams {depth:.1f} mm deep of {peg.depth_mm:g} mm: the force exceeds {force_limit_n:g} N"
            break
    inserted = depth >= peg.depth_mm - SHORT_MM
    if not cause:
        cause = "inserted" if inserted else f"stops {depth:.1f} mm deep of {peg.depth_mm:g} mm"
    return Attempt(
        ticks=tuple(ticks), succeeds=inserted and largest <= force_limit_n, cause=cause,
        measures={"depth_mm": depth, "largest_force_n": largest},
    )  # fmt: skip
