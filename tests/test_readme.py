"""Commands, parameters, sizes and links of the README are right."""

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
COMMANDS = [
    line.partition("#")[0] for line in README.splitlines() if line.startswith("tactoscope ")
]


@pytest.mark.parametrize("line", COMMANDS)
def test_every_listed_command_parses(line):
    app = build_app()
    app.command(view)
    app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)


def test_named_methods_and_parameters_exist():
    for stage, method in re.findall(r"--method (\w+)=(\w+)", README):
        assert method in [m.name for m in BUILT_IN.stage(stage).methods]
    named = re.findall(r"`(?:--set )?(\w+)\.(\w+)[`=]", README)
    stages = {stage.name: stage for stage in BUILT_IN.stages}
    for stage, parameter in named:
        if stage in stages:
            assert any(parameter in list_fields(m) for m in stages[stage].methods), (
                f"{stage}.{parameter}"
            )
    assert ("touch", "steps") in named


def list_fields(method):
    return [field.name for field in fields(method.params)]


def test_set_up_sizes_agree_with_the_makefile():
    for size in ("1.1 GB", "4.0 GB", "2.5 GB"):
        assert size in README
        assert size in MAKEFILE


def test_python_versions_agree_with_the_package():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [c.rpartition(" ")[2] for c in about["classifiers"] if "Python :: 3." in c]
    assert about["requires-python"] == f">={stated[0]}"
    assert f"{stated[0]} to {stated[-1]} were tried" in MAKEFILE
    assert all(version in README for version in stated)


def test_every_linked_file_exists():
    for name in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / name).exists(), name


def test_it_is_short():
    assert len(README.split()) <= 700
