"""Which grasps are held out: by tool, by name, by published lists and by the data set's own
splits.
"""

import json

import pytest

from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.values.frames import Grasp
from pipeline.lab.training.recorded_pairs import assign_roles, list_tool_splits

TOOLS = [f"tool_{k:02}" for k in range(12)]
GRASPS = [Grasp(tool=tool, number=k) for tool in TOOLS for k in range(10)]


def collect_tools(grasps, roles, role):
    return {g.tool for g, r in zip(grasps, roles, strict=True) if r == role}


def test_a_quarter_of_the_tools_and_a_fifth_of_the_other_grasps_are_held_out():
    hold_out = assign_roles(GRASPS, "tool")
    counts = {
        role: hold_out[0].count(role) for role in ("training", "unseen_grasps", "unseen_tools")
    }
    assert counts == {"training": 72, "unseen_grasps": 18, "unseen_tools": 30}
    unseen = collect_tools(GRASPS, hold_out[0], "unseen_tools")
    assert len(unseen) == 3
    trained = collect_tools(GRASPS, hold_out[0], "training")
    assert trained == set(TOOLS) - unseen == collect_tools(GRASPS, hold_out[0], "unseen_grasps")
    assert assign_roles(GRASPS, "tool") == hold_out
    (note,) = hold_out[1]
    assert all(tool in note for tool in unseen)


def test_tools_are_held_out_by_name():
    roles = assign_roles(GRASPS, "tool_03, tool_07")[0]
    assert collect_tools(GRASPS, roles, "unseen_tools") == {"tool_03", "tool_07"}
    with pytest.raises(SettingProblem, match="no tool 'hex' to hold out; there are tool_00"):
        assign_roles(GRASPS, "hex")


def test_splits_of_the_folder_count_without_a_request():
    grasps = [Grasp(tool="hex", split="train", number=k) for k in range(4)]
    grasps += [
        Grasp(tool="hex", split="test/train_only", number=0),
        Grasp(tool="peg", split="test/test_only", number=0),
    ]
    assert assign_roles(grasps)[0] == ("training",) * 4 + ("unseen_grasps", "unseen_tools")
    assert assign_roles(grasps, "hex")[0][:4] == ("unseen_tools",) * 4


def test_a_split_file_names_every_grasp_that_is_used(tmp_path):
    file = tmp_path / "split.json"
    file.write_text(
        json.dumps(
            {"train": [["tool_00", 1], ["tool_00", 2]], "test": [["tool_00", 3], ["tool_01", 1]]}
        )
    )
    roles = assign_roles(GRASPS, str(file))[0]
    assert {
        (g.tool, g.number): r for g, r in zip(GRASPS, roles, strict=True) if r != "left_out"
    } == {
        ("tool_00", 1): "training",
        ("tool_00", 2): "training",
        ("tool_00", 3): "unseen_grasps",
        ("tool_01", 1): "unseen_tools",
    }
    with pytest.raises(FileProblem):
        assign_roles(GRASPS, str(tmp_path / "gone.json"))


def test_published_lists_leave_other_tools_out():
    assert {name: (len(s.training), len(s.unseen)) for name, s in list_tool_splits().items()} == {
        "lab": (9, 3),
        "paper": (12, 6),
    }
    grasps = [
        Grasp(tool=tool, number=k)
        for tool in ("pattern_33", "pattern_35", "other")
        for k in range(5)
    ]
    roles = assign_roles(grasps, "lab")[0]
    assert collect_tools(grasps, roles, "left_out") == {"other"}
    assert collect_tools(grasps, roles, "unseen_tools") == {"pattern_35"}
    assert collect_tools(grasps, roles, "training") == {"pattern_33"}


def test_nothing_left_to_train_on_is_refused():
    with pytest.raises(SettingProblem, match="no grasp is left to train on"):
        assign_roles(GRASPS, ",".join(TOOLS))


def test_a_share_thins_what_is_trained_on_and_nothing_else():
    grasps = [
        Grasp(tool=tool, split="", number=k) for tool in ("hex", "peg", "rod") for k in range(20)
    ]
    roles = {share: assign_roles(grasps, "rod", share)[0] for share in (1.0, 0.5, 0.1)}
    kept = {
        share: {k for k, role in enumerate(r) if role == "training"} for share, r in roles.items()
    }
    assert [len(kept[share]) for share in (1.0, 0.5, 0.1)] == [32, 16, 3]
    assert kept[0.1] < kept[0.5] < kept[1.0], "more pairs are added to fewer"
    for share in (0.5, 0.1):
        assert all(a == b for a, b in zip(roles[1.0], roles[share], strict=True) if a != "training")
    assert "of 32 grasps to train on a share of 0.1 is used" in assign_roles(grasps, "rod", 0.1)[1]
    assert assign_roles(grasps, "rod", 1e-3)[0].count("training") == 1
