"""Constants of a gel's depth: all of them are members of the settings of a node, and used."""

from __future__ import annotations

import ast
import dataclasses
import re
from pathlib import Path

import pytest

import pipeline.stages.depth as depth
from pipeline.stages.depth.gel import chain, settings

ROOT = Path(depth.__file__).parent
NODES = {node.name: getattr(settings, node.name.upper()) for node in chain.NODES}
# Kernels compile theirs in. The check of an instance is no part of a frame's chain.
HELPERS = ("change_detection", "contact", "frame_checks", "rest_level")
MODULES = (
    *(ROOT / f"{name}.py" for name in HELPERS),
    *(path for path in (ROOT / "gel").glob("*.py") if path.stem != "settings"),
    *(path for path in (ROOT / "illumination").glob("*.py") if "kernels" not in path.stem),
)


@pytest.mark.parametrize("name", NODES)
def test_every_constant_of_a_node_is_used(name):
    text = "\n".join(path.read_text() for path in ROOT.rglob("*.py"))
    read = set(re.findall(rf"\b(?:{name.upper()}|settings)\.(\w+)", text))
    assert {field.name for field in dataclasses.fields(NODES[name])} <= read


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_no_module_of_the_chain_has_a_constant_of_its_own(path):
    values = [
        node.value
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign | ast.AnnAssign) and not _is_cache(node.value)
    ]
    numbers = [
        leaf.value
        for value in values
        for leaf in ast.walk(value)
        if isinstance(leaf, ast.Constant) and isinstance(leaf.value, int | float)
    ]
    assert not numbers


def _is_cache(value):
    return isinstance(value, ast.Call) and ast.unparse(value.func) == "Memo"
