"""Insertion: a tool that two fingers hold in an unknown pose is aligned over its hole and lowered compliantly.

The controller is made for soft bubbles and reads GelSlims through a translation (paper, downstream tasks). Clearance,
lead-in, force limit and compliance are not in the paper and are chosen here.
"""

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.base.arrays import Doubles
from pipeline.base.files import read_toml
from pipeline.base.progress import SILENT, Progress
from pipeline.base.typed_data import FileName, Number, convert
from pipeline.base.units import MeshUnit
from pipeline.geometry import rigid
from pipeline.geometry.meshes import Mesh
from pipeline.simulation import shapes
from pipeline.simulation.shapes.solids import transform_mesh
from pipeline.tasks.descent import insert
from pipeline.tasks.grasp import SOURCE, TARGET, run_through_touches
from pipeline.tasks.in_hand import PlanarPose, parse_planar_pose
from pipeline.tasks.peg import Peg, cut_peg, make_hole_mesh
from pipeline.tasks.scene_bodies import make_fingers
from pipeline.tasks.task import (
    Attempt,
    ManipulationTask,
    RecordedRollout,
    Rollout,
    SceneBody,
    TaskScene,
    TrialPlan,
)

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """A tool and its hole; the tool frame has +x along the insertion and z along the fingers' normal."""

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
    "screwdriver": (rigid.translation(10.0, 0.0, 0.0) @ rigid.rotation((0.0, -0.5 * math.pi, 0.0)), 5.0),
    "spanner": (rigid.rotation((0.0, 0.0, -math.radians(195.0))), 8.0),  # the handle
    "pencil": (np.eye(4), 8.0),
}
PAPER = {  # of 30; the paper's tools 1 to 3 are others
    ("hex_key", "t2t"): "18/30", ("screwdriver", "t2t"): "10/30", ("spanner", "t2t"): "15/30",
    ("pencil", "t2t"): "21/30", ("hex_key", "vqvae"): "9/30", ("screwdriver", "vqvae"): "8/30",
    ("spanner", "vqvae"): "15/30", ("pencil", "vqvae"): "7/30",
}  # fmt: skip


@lru_cache(maxsize=8)
def make_tool(case: str) -> Tool:
    """A tool of the catalogue, or of a TOML file; raises FileProblem for a damaged one."""
    if case not in _TOOLS:
        return load_tool(Path(case))
    tool_from_shape, depth_mm = _TOOLS[case]
    mesh = transform_mesh(shapes.make_shape(case).mesh, tool_from_shape)
    return Tool(name=case, mesh=mesh, depth_mm=depth_mm)


def load_tool(path: Path) -> Tool:
    """A user's tool: a TOML file with `mesh`, `depth_mm`, and if need be `mesh_unit`, `face`, `axis_deg` and limits.

    The mesh is laid with `face` to the left finger and turned by `axis_deg` in the fingers' plane, so that its
    inserted end points to +x. Raises FileProblem.
    """
    read = convert(read_toml(path, "the task"), _ToolFile, "the task", path)
    shape = shapes.load_mesh_shape(path.parent / read.mesh, read.mesh_unit, read.face)
    mesh = transform_mesh(shape.mesh, rigid.rotation((0.0, 0.0, math.radians(read.axis_deg))))
    tool = Tool(
        name=path.stem, mesh=mesh, depth_mm=read.depth_mm, lead_in_mm=read.lead_in_mm,
        force_limit_n=read.force_limit_n,
    )  # fmt: skip
    assert tool.peg.depth_mm  # raises MeshProblem now and not in a trial
    return tool


def run(plan: TrialPlan, progress: Progress = SILENT) -> tuple[Rollout, ...]:
    """One grasp, estimated through every touch, inserted at every clearance."""
    tool = make_tool(plan.case)
    return run_through_touches(
        plan, tool.mesh, tool.name, partial(measure_miss_mm, tool.peg), partial(_lower, tool), progress
    )


def measure_miss_mm(peg: Peg, held: PlanarPose, believed: PlanarPose) -> float:
    """How far the inserted part lies off the hole's axis in the fingers' plane: the larger of its two ends."""
    y, z = 0.5 * (peg.points_mm.min(axis=0) + peg.points_mm.max(axis=0))[1:]
    ends = np.array([(peg.tip_mm, y, z), (peg.tip_mm - peg.depth_mm, y, z)])
    off = rigid.apply(rigid.invert(believed.matrix) @ held.matrix, ends) - ends
    return float(np.abs(off[:, 1]).max())


def _lower(tool: Tool, held: PlanarPose, believed: PlanarPose, clearance_mm: float) -> Attempt:
    return insert(
        tool.peg, held.matrix, believed.matrix, clearance_mm=clearance_mm, lead_in_mm=tool.lead_in_mm,
        force_limit_n=tool.force_limit_n,
    )  # fmt: skip


def build_scene(rollout: RecordedRollout) -> TaskScene:
    """The hole's plate and both fingers around the tool."""
    tool, first = make_tool(rollout.plan.case), rollout.summary.decisions[0]
    plate = make_hole_mesh(tool.peg, rollout.summary.tolerance_mm, tool.lead_in_mm)
    fingers = make_fingers(tool.mesh, parse_planar_pose(first.truth))
    return TaskScene(
        bodies=(SceneBody(name="hole", mesh=plate), *fingers),
        hand_from_estimate=lambda decision: parse_planar_pose(decision.estimate).matrix,
    )


TASK = ManipulationTask(
    name="insertion", title="Peg insertion", source=SOURCE, target=TARGET, cases=tuple(_TOOLS),
    touches=("t2t", "vqvae", "true", "none"), tolerances_mm=TOLERANCES_MM, tolerance_title="clearance, mm", n_trials=30,
    error_title="off the hole's axis", run=run, build_scene=build_scene, published=PAPER,
    load_case=lambda path: load_tool(path).name,
)  # fmt: skip
