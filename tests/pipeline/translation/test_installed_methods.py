"""Methods that other installed packages add to stages by entry points."""

from __future__ import annotations

import os
import subprocess
import sys

from pipeline.core.graph import Method
from pipeline.core.params import NoParams
from pipeline.translation.catalogue import BUILT_IN
from tests.pipeline.translation.toys import MELT

TOY_METHOD = """
from pipeline.core.params import NoParams
from pipeline.core.graph import Method

def estimate_nothing(frame, sensor, params, progress):
    raise NotImplementedError

METHOD = Method(stage="depth", name="toy", title="Toy", run=estimate_nothing, params=NoParams, reads=("frame", "source"))
"""
ENTRY_POINTS = """
[tactoscope.methods]
broken = toy_method_that_is_missing:METHOD
text = toy_method:__name__
toy = toy_method:METHOD
"""
PRINT_METHODS = """
from pipeline.translation.catalogue import BUILT_IN
print([m.name for m in BUILT_IN.stage("depth").methods])
"""


def test_a_method_of_an_installed_package_is_offered_and_broken_ones_are_warnings(tmp_path):
    (tmp_path / "toy_method.py").write_text(TOY_METHOD)
    package = tmp_path / "toy_method-0.1.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: toy_method\nVersion: 0.1\n")
    (package / "entry_points.txt").write_text(ENTRY_POINTS)
    path = os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])
    done = subprocess.run(
        [sys.executable, "-c", PRINT_METHODS],
        check=False,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    names = [m.name for m in BUILT_IN.stage("depth").methods]
    assert done.stdout.strip() == str([*names, "toy"])
    warnings = done.stderr.strip().splitlines()
    assert len(warnings) == 2
    assert "toy_method_that_is_missing" in warnings[0]
    assert "it is a str, not a Method" in warnings[1]


def test_a_method_is_added_to_its_stage_only(caplog):
    catalogue = BUILT_IN.add_methods((MELT,))
    assert catalogue.method("touch", "melt").run is MELT.run
    assert catalogue.stage("touch").methods[:-1] == BUILT_IN.stage("touch").methods
    assert catalogue.stage("depth") is BUILT_IN.stage("depth")
    assert not caplog.records


def test_methods_of_unknown_stages_and_taken_names_are_left_out(caplog):
    lost = Method(stage="smell", name="toy", title="Toy", run=print, params=NoParams, reads=())
    taken = Method(stage="touch", name="physics", title="Toy", run=print, params=NoParams, reads=())
    catalogue = BUILT_IN.add_methods((lost, taken))
    assert catalogue.stages == BUILT_IN.stages
    assert ["'smell'" in caplog.text, "'physics'" in caplog.text, len(caplog.records)] == [
        True,
        True,
        2,
    ]
