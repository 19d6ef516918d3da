"""The set-up's first step on systems other than this one: what is asked of dpkg and apt is
answered by stand-ins.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "system-packages.sh"
NEEDED = re.search(r"packages=\((.*?)\)", SCRIPT.read_text(), re.DOTALL)[1].split()
# on Ubuntu 24.04 and Debian 13, where it provides the name it had before
RENAMED = "libglib2.0-0t64"


@pytest.fixture
def system(tmp_path):
    """Run the script as somebody on a system with these packages installed.

    Returns exit code and stderr.
    """

    def run(installed, *, root=False, environment=None):
        tools = {
            "dpkg-query": "".join(f"echo '{line}'\n" for line in installed),
            "apt-cache": 'test "$2" != libglib2.0-0 || '
            f'{{ echo "N: no such package" >&2; exit 100; }}  # knows {RENAMED}',
            "apt-get": f'echo "$@" >> {tmp_path}/apt-get.log',
            "id": f"echo {0 if root else 1000}",
        }
        for name, text in tools.items():
            (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
            (tmp_path / name).chmod(0o755)
        variables = {
            "PATH": f"{tmp_path}:{os.environ['PATH']}",
            "PYTHON": "false",
            **(environment or {}),
        }
        done = subprocess.run(
            ["bash", str(SCRIPT)], env=variables, capture_output=True, text=True, check=False
        )
        assert not done.stdout
        return done.returncode, done.stderr

    return run


def debian_13(without=()):
    lines = [f"installed {name}, " for name in NEEDED if name not in ("libglib2.0-0", *without)]
    return [
        *lines,
        f"installed {RENAMED}, libglib2.0-0 (= 2.84.4-3), libglib2.0-0-udeb",
        "config-files libusb-1.0-0, ",
    ]


def test_a_package_that_another_stands_in_for_is_not_missing(system):
    assert system(debian_13()) == (0, "")


def test_who_is_not_root_reads_the_line_to_run(system):
    code, said = system(debian_13(without=("libegl1", "xvfb")))
    assert code == 1
    assert (
        "  sudo apt-get update && sudo apt-get install -y --no-install-recommends xvfb libegl1\n"
        in said
    )


def test_the_line_names_a_package_as_this_release_does(system):
    code, said = system([line for line in debian_13() if RENAMED not in line])
    assert code == 1
    assert said.splitlines()[1].split()[-1] == RENAMED


def test_a_package_that_was_removed_but_left_its_settings_is_missing(system):
    assert "libusb-1.0-0" in system(debian_13(without=("libusb-1.0-0",)))[1]


def test_who_cannot_have_them_installed_goes_on_without(system):
    code, said = system(debian_13(without=("xvfb",)), environment={"WITHOUT_SYSTEM_PACKAGES": "1"})
    assert code == 0
    assert "--no-install-recommends xvfb" in said


def test_root_has_them_installed(system, tmp_path):
    assert system(debian_13(without=("xvfb",)), root=True) == (0, "")
    assert (tmp_path / "apt-get.log").read_text().splitlines()[-1].split()[-2:] == ["xvfb", "-qq"]
