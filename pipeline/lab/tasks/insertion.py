"""Insertion: a tool that two fingers hold in an unknown pose is aligned over its hole and lowered
compliantly.

The controller is made for soft bubbles and reads GelSlims through a translation (paper, downstream
tasks). Clearance, lead-in, force limit and compliance are not in the paper and are chosen here. Peg
and hole are convex pieces: the tip of a tool, and walls around the tip's outline with a clearance.
"""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.core.arrays import Doubles
from pipeline.core.derived import derive_once
from pipeline.core.errors import MeshProblem
from pipeline.core.files import read_toml
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.params import MeshUnit
from pipeline.core.progress import SILENT, Progress
from pipeline.core.typed_data import FileName, Number, convert
from pipeline.lab.tasks.grasp import (
    SOURCE,
    TARGET,
    PlanarPose,
    parse_planar_pose,
    run_through_touches,
)
from pipeline.lab.tasks.scene import Scene, write_box, write_compliant_joints, write_pose
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
from pipeline.physics.simulation.poses import cut_edges
from pipeline.physics.simulation.shapes.solids import transform_mesh

_MARGIN_MM = 1.0  # of the peg beyond what is inserted
_MAX_WALLS = 16  # a rounder outline gets this many walls
_STRAIGHT = 1e-6  # squared sine of two outline edges that are one
_WALL_MM = 20.0  # thickness and half length of walls
# the plate on display: width around and height below the hole
_PLATE_MM = 10.0
_BELOW_MM = 2.0
_PLATE_SIDES = 96


@frozen
class Peg:
    """The part of a tool that is inserted along +x."""

    points_mm: Doubles  # (n, 3) corners of its convex hull in the tool frame
    tip_mm: float  # x of the tip
    depth_mm: float  # full depth
    directions: Doubles  # (k, 2) outward normals of the hole's walls in the tool's y and z
    reach_mm: Doubles  # (k,) how far the peg reaches along each


def cut_peg(mesh: Mesh, depth_mm: float) -> Peg:
    """The peg at the +x end of a tool; raises MeshProblem for a tool shorter than the depth."""
    from scipy.spatial import ConvexHull

    x = mesh.vertices_mm[:, 0]
    tip = float(x.max())
    start = tip - depth_mm - _MARGIN_MM
    if start < x.min():
        raise MeshProblem(
            f"the tool {mesh.name!r} is {np.ptp(x):.3g} mm long along x, too short for "
            f"{depth_mm:g} mm"
        )
    cut = cut_edges(mesh.vertices_mm, mesh.triangles, 0, start)
    points = np.concatenate([mesh.vertices_mm[x >= start], cut])
    hull = points[np.sort(ConvexHull(points).vertices)]
    inserted = points[points[:, 0] >= start + _MARGIN_MM - 1e-9, 1:]
    directions = _list_walls(inserted if len(inserted) > 2 else points[:, 1:])
    return Peg(
        points_mm=hull,
        tip_mm=tip,
        depth_mm=depth_mm,
        directions=directions,
        reach_mm=(hull[:, 1:] @ directions.T).max(axis=0),
    )


def write_hole(peg: Peg, clearance_mm: float, lead_in_mm: float) -> str:
    """MJCF of a plate at z <= 0 with the peg's hole: wider by `clearance_mm` in all, with a 45
    degree lead-in.

    The tool's x points down, its y along -x and its z along +y of the world.
    """
    pieces: list[str] = []

    def add_box(half_mm: tuple[float, float, float], pose: Doubles) -> None:
        pieces.append(write_box(half_mm, pose, 'friction="0.3"'))

    for (u, v), reach in zip(peg.directions, peg.reach_mm, strict=True):
        heading = math.atan2(v, -u)
        wall = rigid.rotation((0.0, 0.0, heading)) @ rigid.translation(
            reach + 0.5 * clearance_mm, 0.0, 0.0
        )
        half_height = 0.5 * (peg.depth_mm + 10.0)
        middle = rigid.translation(0.5 * _WALL_MM, 0.0, -lead_in_mm - half_height)
        add_box((0.5 * _WALL_MM, _WALL_MM, half_height), wall @ middle)
        if lead_in_mm > 0:  # a slab whose upper face rises by 45 degrees from the wall's upper edge
            slope = rigid.translation(0.0, 0.0, -lead_in_mm) @ rigid.rotation(
                (0.0, -0.25 * math.pi, 0.0)
            )
            half = 0.5 * math.sqrt(2.0) * lead_in_mm
            add_box((half, _WALL_MM, 2.0), wall @ slope @ rigid.translation(half, 0.0, -2.0))
            top = rigid.translation(lead_in_mm + 0.5 * _WALL_MM, 0.0, -2.0)
            add_box((0.5 * _WALL_MM, 2.0 * _WALL_MM, 2.0), wall @ top)
    return f'<body name="plate">{"".join(pieces)}</body>'


def make_hole_mesh(peg: Peg, clearance_mm: float, lead_in_mm: float) -> Mesh:
    """A round plate with the hole of `write_hole`, for the 3D scene."""
    angles = list_angles(_PLATE_SIDES)
    # the tool's y and z in the world
    along = np.column_stack([-np.cos(angles), np.sin(angles)]) @ peg.directions.T
    reach = peg.reach_mm + 0.5 * clearance_mm
    hole = np.where(along > _STRAIGHT, reach / np.maximum(along, _STRAIGHT), np.inf).min(axis=1)
    outside = np.full_like(hole, hole.max() + _PLATE_MM)
    deep_mm = peg.depth_mm + _BELOW_MM
    profile = (
        (outside, 0.0),
        (hole + lead_in_mm, 0.0),
        (hole, -lead_in_mm),
        (hole, -deep_mm),
        (outside, -deep_mm),
    )
    return make_ring(profile, angles, "hole")


def _list_walls(outline_mm: Doubles) -> Doubles:
    """Outward normals (k, 2) of an outline's convex hull.

    Evenly spread ones for a round outline.
    """
    from scipy.spatial import ConvexHull

    normals = ConvexHull(outline_mm).equations[:, :2]
    kept: list[Doubles] = []
    for normal in normals:
        if all(1.0 - float(normal @ other) > _STRAIGHT for other in kept):
            kept.append(normal)
    if len(kept) <= _MAX_WALLS:
        return np.array(kept)
    angle = 2.0 * math.pi * np.arange(_MAX_WALLS) / _MAX_WALLS
    return np.column_stack([np.cos(angle), np.sin(angle)])


LEAD_IN_MM = 0.5  # 45 degree chamfer of the hole
FORCE_LIMIT_N = 15.0
TOLERANCES_MM = (0.25, 0.5, 1.0, 2.0)
_Positive = Annotated[float, Meta(gt=0.0, le=1e4)]


class _ToolFile(msgspec.Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """A user's tool, see `load_tool`."""

    mesh: FileName
    depth_mm: _Positive
    mesh_unit: MeshUnit = "auto"
    face: Literal["-x", "+x", "-y", "+y", "-z", "+z"] = "-z"
    axis_deg: Number = 0.0
    lead_in_mm: Annotated[float, Meta(ge=0.0, le=1e3)] = LEAD_IN_MM
    force_limit_n: _Positive = FORCE_LIMIT_N


@frozen
class Tool:
    """A tool and its hole; the tool frame has +x along the insertion and z along the fingers'
    normal.
    """

    name: str
    mesh: Mesh
    depth_mm: float
    lead_in_mm: float = LEAD_IN_MM
    force_limit_n: float = FORCE_LIMIT_N

    @property
    def peg(self) -> Peg:
        """The part that is inserted."""
        return cut_peg(self.mesh, self.depth_mm)


_TOOLS: dict[str, tuple[Doubles, float]] = {  # tool_from_shape, depth of the hole in mm
    "hex_key": (rigid.rotation((0.0, 0.0, -0.5 * math.pi)), 8.0),  # the long arm
    "screwdriver": (
        rigid.translation(10.0, 0.0, 0.0) @ rigid.rotation((0.0, -0.5 * math.pi, 0.0)),
        5.0,
    ),
    "spanner": (rigid.rotation((0.0, 0.0, -math.radians(195.0))), 8.0),  # the handle
    "pencil": (np.eye(4), 8.0),
}
PAPER = {  # of 30; the paper's tools 1 to 3 are others
    ("hex_key", "t2t"): "18/30",
    ("screwdriver", "t2t"): "10/30",
    ("spanner", "t2t"): "15/30",
    ("pencil", "t2t"): "21/30",
    ("hex_key", "vqvae"): "9/30",
    ("screwdriver", "vqvae"): "8/30",
    ("spanner", "vqvae"): "15/30",
    ("pencil", "vqvae"): "7/30",
}


@derive_once
def make_tool(case: str) -> Tool:
    """A tool of the catalogue, or of a TOML file; raises FileProblem for a damaged one."""
    if case not in _TOOLS:
        return load_tool(Path(case))
    tool_from_shape, depth_mm = _TOOLS[case]
    mesh = transform_mesh(shapes.make_shape(case).mesh, tool_from_shape)
    return Tool(name=case, mesh=mesh, depth_mm=depth_mm)


def load_tool(path: Path) -> Tool:
    """A user's tool: a TOML file with `mesh`, `depth_mm`, and if need be `mesh_unit`, `face`,
    `axis_deg` and limits.

    The mesh is laid with `face` to the left finger and turned by `axis_deg` in the fingers' plane,
    so that its inserted end points to +x. Raises FileProblem.
    """
    read = convert(read_toml(path, "the task"), _ToolFile, "the task", path)
    shape = shapes.load_mesh_shape(path.parent / read.mesh, read.mesh_unit, read.face)
    mesh = transform_mesh(shape.mesh, rigid.rotation((0.0, 0.0, math.radians(read.axis_deg))))
    tool = Tool(
        name=path.stem,
        mesh=mesh,
        depth_mm=read.depth_mm,
        lead_in_mm=read.lead_in_mm,
        force_limit_n=read.force_limit_n,
    )
    assert tool.peg.depth_mm  # raises MeshProblem now and not in a trial
    return tool


def run(plan: TrialPlan, progress: Progress = SILENT) -> tuple[Rollout, ...]:
    """One grasp, estimated through every touch, inserted at every clearance."""
    tool = make_tool(plan.case)
    return run_through_touches(
        plan,
        tool.mesh,
        tool.name,
        partial(measure_miss_mm, tool.peg),
        partial(_lower, tool),
        progress,
    )


def measure_miss_mm(peg: Peg, held: PlanarPose, believed: PlanarPose) -> float:
    """How far the inserted part lies off the hole's axis: the larger of its two ends."""
    y, z = 0.5 * (peg.points_mm.min(axis=0) + peg.points_mm.max(axis=0))[1:]
    ends = np.array([(peg.tip_mm, y, z), (peg.tip_mm - peg.depth_mm, y, z)])
    off = rigid.apply(rigid.invert(believed.matrix) @ held.matrix, ends) - ends
    return float(np.linalg.norm(off[:, 1:], axis=1).max())


def _lower(tool: Tool, held: PlanarPose, believed: PlanarPose, clearance_mm: float) -> Attempt:
    return insert(
        tool.peg,
        held.matrix,
        believed.matrix,
        clearance_mm=clearance_mm,
        lead_in_mm=tool.lead_in_mm,
        force_limit_n=tool.force_limit_n,
    )


def build_scene(rollout: RecordedRollout) -> TaskScene:
    """The hole's plate and both fingers around the tool."""
    tool = make_tool(rollout.plan.case)
    first = rollout.summary.decisions[0]
    plate = make_hole_mesh(tool.peg, rollout.summary.tolerance_mm, tool.lead_in_mm)
    fingers = make_fingers(tool.mesh, parse_planar_pose(first.truth))
    return TaskScene(
        bodies=(SceneBody(name="hole", mesh=plate), *fingers),
        hand_from_estimate=lambda decision: parse_planar_pose(decision.estimate).matrix,
    )


TASK = ManipulationTask(
    name="insertion",
    title="Peg insertion",
    source=SOURCE,
    target=TARGET,
    cases=tuple(_TOOLS),
    touches=("t2t", "vqvae", "true", "none"),
    tolerances_mm=TOLERANCES_MM,
    tolerance_title="clearance, mm",
    n_trials=30,
    holds_object=True,
    error_title="off the hole's axis",
    run=run,
    build_scene=build_scene,
    published=PAPER,
    load_case=lambda path: load_tool(path).name,
)


TICK_S = 0.02
# of the hand's impedance control
STIFFNESS_N_MM = 2.0
STIFFNESS_NMM_RAD = 2000.0
HAND_KG = 0.5
# of the descent, and the tip's height at its start if the belief is true
SPEED_MM_S = 30.0
START_MM = 15.0
BEYOND_MM = 4.0  # commanded beyond the full depth, for a tip that is shorter than believed
SETTLE_S = 0.2
SHORT_MM = 0.3  # of the full depth that still counts
WORLD_FROM_UPRIGHT: Doubles = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""A tool over its hole: its x points down, its z, the normal of the fingers, along the world's
y.
"""


def insert(
    peg: Peg,
    hand_from_tool: Doubles,
    believed: Doubles,
    *,
    clearance_mm: float,
    lead_in_mm: float,
    force_limit_n: float,
) -> Attempt:
    """Lower a tool that the hand holds at `hand_from_tool` as if it held it at `believed` (4,
    4).
    """
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
        '<geom type="mesh" mesh="peg" friction="0.3" mass="0" '
        f"{write_pose(turned @ hand_from_tool)}/></body>"
    )
    scene = Scene(
        write_hole(peg, clearance_mm, lead_in_mm) + body,
        extra_xml=actuators,
        meshes_mm={"peg": peg.points_mm},
    )
    ticks: list[Tick] = []
    full_mm = START_MM + peg.depth_mm + BEYOND_MM
    largest = 0.0
    cause = ""
    depth = -START_MM
    n_ticks = round((full_mm / SPEED_MM_S + SETTLE_S) / TICK_S)
    for tick in range(1, n_ticks + 1):
        lowered = min(full_mm, SPEED_MM_S * TICK_S * tick)
        scene.command("hand_z", -1e-3 * lowered)
        scene.advance(TICK_S)
        hand = scene.get_pose("hand") @ turned
        force = scene.measure_contact_force("hand")
        world_from_tool = hand @ hand_from_tool
        depth = -float(rigid.apply(world_from_tool, (peg.tip_mm, 0.0, 0.0))[2])
        ticks.append(
            Tick(
                time_s=TICK_S * tick,
                world_from_object=world_from_tool,
                world_from_hand=hand,
                commanded=rigid.translation(0.0, 0.0, -lowered) @ world_from_hand,
                force_n=force,
            )
        )
        largest = max(largest, float(np.linalg.norm(force)))
        if largest > force_limit_n:
            cause = (
                f"jams {depth:.1f} mm deep of {peg.depth_mm:g} mm: the force exceeds "
                f"{force_limit_n:g} N"
            )
            break
        if depth >= peg.depth_mm:  # at the bottom of the hole: pushing on would jam it
            break
    inserted = depth >= peg.depth_mm - SHORT_MM
    if not cause:
        cause = "inserted" if inserted else f"stops {depth:.1f} mm deep of {peg.depth_mm:g} mm"
    return Attempt(
        ticks=tuple(ticks),
        succeeds=inserted and largest <= force_limit_n,
        cause=cause,
        measures={"depth_mm": depth, "largest_force_n": largest},
    )
