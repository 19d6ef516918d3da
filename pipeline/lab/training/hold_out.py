"""Which recorded grasps are trained on, and which validate: other grasps of the same tools, and
other tools.

Both validation splits are disjoint, and neither holds a grasp that is trained on.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.core.errors import SettingProblem, escape_text
from pipeline.core.values.frames import Grasp
from pipeline.io.grasp_files import is_training_split, read_split_file
from pipeline.lab.training.task import SPLITS
from pipeline.physics.simulation import shapes

Role = Literal["training", "unseen_grasps", "unseen_tools", "left_out"]
BY_TOOL = "tool"
# held out: of 12 tools 3, as the lab's code does; of grasps a fifth, as well
_TOOL_SHARE = 0.25
_GRASP_SHARE = 0.2
_MAX_NAMES = 12  # in a message
HOLD_OUT_HELP = (
    "`tool` for a quarter of the tools, names of tools separated by commas, `lab` or `paper` for "
    "published lists of "
    "tools, or a split.json; without it the splits of the folder, else `tool`"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolSplit:
    """A published split by tools."""

    training: tuple[str, ...]
    unseen: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldOut:
    """The role of every grasp, and what was decided."""

    roles: tuple[Role, ...]
    notes: tuple[str, ...]


def list_tool_splits() -> Mapping[str, ToolSplit]:
    """Published splits by name.

    `lab`: the tools that train_single.py of the lab's depth_anything_v2 lists. `paper`: the twelve
    training objects of the simulated catalogue, which stand for the paper's, and its six unseen
    ones.
    """
    lab = (
        "01_2_lines_angle_1",
        "02_2_lines_angle_2",
        "03_2_lines_angle_3",
        "04_3_lines_angle_1",
        "06_5_lines_angle_1",
        "31_rod",
        "32",
        "33",
        "37",
    )
    return {
        "lab": ToolSplit(
            training=tuple(f"pattern_{name}" for name in lab),
            unseen=("pattern_05_3_lines_angle_2", "pattern_35", "pattern_36"),
        ),
        "paper": ToolSplit(
            training=tuple(shapes.list_shapes("training")),
            unseen=tuple(shapes.list_shapes("unseen")),
        ),
    }


def assign_roles(grasps: Sequence[Grasp], hold_out: str = "", share: float = 1.0) -> HoldOut:
    """The role of every grasp; `hold_out` is as `HOLD_OUT_HELP` says. The same grasps give the same
    roles.

    Of the grasps to train on, `share` is used, and more for a larger share; the others are left
    out.

    Raises SettingProblem for an unknown tool or where nothing is left to train on, FileProblem for
    a split file.
    """
    has_own_splits = any(not is_training_split(grasp.split) for grasp in grasps)
    if hold_out.endswith(".json") or (not hold_out and has_own_splits):
        split_of = read_split_file(Path(hold_out)) if hold_out else None
        roles = _roles_by_split(grasps, split_of)
    else:
        roles = _roles_by_tool(
            grasps, _select_tools({grasp.tool for grasp in grasps}, hold_out or BY_TOOL)
        )
    if "training" not in roles:
        raise SettingProblem(
            f"no grasp is left to train on with --hold-out {hold_out or BY_TOOL}; hold out fewer "
            "tools"
        )
    n_all = roles.count("training")
    _thin_training(roles, share)
    notes = _describe(grasps, roles)
    if share < 1.0:
        notes += (f"of {n_all} grasps to train on a share of {share:g} is used",)
    return HoldOut(roles=tuple(roles), notes=notes)


def _thin_training(roles: list[Role], share: float) -> None:
    """Leave out all but a share of the grasps to train on, at least one."""
    trained = np.flatnonzero([role == "training" for role in roles])
    n_used = max(1, round(share * len(trained)))
    for k in np.random.default_rng(0).permutation(trained)[n_used:]:
        roles[k] = "left_out"


def _roles_by_split(
    grasps: Sequence[Grasp], split_of: Mapping[tuple[str, int], str] | None
) -> list[Role]:
    """Roles by the data set's own splits, or those of a file.

    Grasps that the file does not list are left out.
    """
    splits = [g.split if split_of is None else split_of.get((g.tool, g.number)) for g in grasps]
    trained = {
        g.tool
        for g, split in zip(grasps, splits, strict=True)
        if split is not None and is_training_split(split)
    }

    def decide(grasp: Grasp, split: str | None) -> Role:
        if split is None:
            return "left_out"
        if is_training_split(split):
            return "training"
        return "unseen_grasps" if grasp.tool in trained else "unseen_tools"

    return [decide(g, split) for g, split in zip(grasps, splits, strict=True)]


def _select_tools(tools: set[str], hold_out: str) -> ToolSplit:
    """The tools to train on and to hold out."""
    names = sorted(tools)
    published = list_tool_splits().get(hold_out)
    if published is not None:
        return published
    if hold_out == BY_TOOL:
        n = max(1, round(_TOOL_SHARE * len(names))) if len(names) > 1 else 0
        unseen = {names[k] for k in np.random.default_rng(0).permutation(len(names))[:n]}
    else:
        unseen = {name.strip() for name in hold_out.split(",")}
        unknown = sorted(unseen - tools)
        if unknown:
            known = ", ".join(names[:_MAX_NAMES]) + (", ..." if len(names) > _MAX_NAMES else "")
            raise SettingProblem(
                f"no tool {unknown[0]!r} to hold out; there are {escape_text(known)}"
            )
    return ToolSplit(training=tuple(tools - unseen), unseen=tuple(sorted(unseen)))


def _roles_by_tool(grasps: Sequence[Grasp], tools: ToolSplit) -> list[Role]:
    """Unseen tools by name, and a fifth of the grasps of every other tool."""
    roles: list[Role] = ["unseen_tools" if g.tool in tools.unseen else "left_out" for g in grasps]
    for tool in tools.training:
        own = [k for k, grasp in enumerate(grasps) if grasp.tool == tool]
        order = np.random.default_rng(0).permutation(len(own))
        n_held_out = math.ceil(_GRASP_SHARE * len(own)) if len(own) > 1 else 0
        for place, k in enumerate(order):
            roles[own[k]] = "unseen_grasps" if place < n_held_out else "training"
    return roles


def _describe(grasps: Sequence[Grasp], roles: Sequence[Role]) -> tuple[str, ...]:
    counts = Counter(roles)
    unseen = sorted(
        {g.tool for g, role in zip(grasps, roles, strict=True) if role == "unseen_tools"}
    )
    shown = escape_text(", ".join(unseen[:_MAX_NAMES])) + (
        ", ..." if len(unseen) > _MAX_NAMES else ""
    )
    tools = f" ({shown})" if unseen else ""
    parts = [f"{counts['training']} grasps are trained on"]
    parts += [
        f"{counts[split]} validate as "
        f"{split.replace('_', ' ')}{tools if split == 'unseen_tools' else ''}"
        for split in SPLITS
    ]
    if counts["left_out"]:
        parts.append(f"{counts['left_out']} belong to no list and are left out")
    return (", ".join(parts),)
