"""What the README says can be typed, installed and found is so."""

from __future__ import annotations

import re
import shlex
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from app.command import view
from pipeline.cli.main import build_app
from pipeline.translation.catalogue import BUILT_IN

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
TYPED = [line.partition("#")[0] for line in README.splitlines() if line.startswith("tactoscope ")]


@pytest.mark.parametrize("line", TYPED)
def test_every_command_of_the_list_can_be_typed(line):
    app = build_app()
    app.command(view)
    app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)


def test_methods_and_parameters_that_it_names_are_there():
    for slot, method in re.findall(r"--method (\w+)=(\w+)", README):
        if slot != "slot":
            assert method in [m.name for m in BUILT_IN.stage(slot).methods]
    named = re.findall(r"`(?:--set )?(\w+)\.(\w+)[`=]", README)
    slots = {slot.name: slot for slot in BUILT_IN.stages}
    for slot, parameter in named:
        if slot in slots and slot != "slot":
            assert any(parameter in fields_of(m) for m in slots[slot].methods), f"{slot}.{parameter}"
    assert ("touch", "caution") in named


def fields_of(method):
    return [field.name for field in fields(method.params)]


def test_sizes_of_the_setup_are_those_that_it_tells():
    for size in ("1.2 GB", "3.9 GB", "2.5 GB"):
        assert size in README
        assert size in MAKEFILE


def test_versions_of_python_are_those_that_the_package_states():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [c.rpartition(" ")[2] for c in about["classifiers"] if "Python :: 3." in c]
    assert about["requires-python"] == f">={stated[0]}"
    assert f"{stated[0]} to {stated[-1]} were tried" in MAKEFILE
    assert all(version in README for version in stated)


def test_every_file_that_it_points_to_is_there():
    for name in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / name).exists(), name
