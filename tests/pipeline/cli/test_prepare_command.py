"""`tactoscope prepare`: it compiles every kernel, once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.cli import prepare
from pipeline.core import compiling
from pipeline.core.graph import Graph

ROOT = Path(__file__).resolve().parents[3]


def test_nothing_runs_once_all_is_compiled(monkeypatch, tmp_path, capsys):
    (tmp_path / "prepared").touch()
    monkeypatch.setattr(compiling, "kernel_folder", lambda: tmp_path)
    monkeypatch.setattr(prepare, "_list_tasks", pytest.fail)
    assert prepare.prepare() == 0
    assert str(tmp_path) in capsys.readouterr().out


@pytest.mark.parametrize(("source", "target"), prepare._DIRECTIONS)
def test_an_installed_package_without_samples_prepares_by_a_simulated_press(
    monkeypatch, tmp_path, source, target
):
    monkeypatch.setattr(prepare, "SAMPLE_RECORDING", tmp_path / "missing.h5")
    ran = []
    evaluate = Graph.evaluate
    monkeypatch.setattr(Graph, "evaluate", lambda *args, **how: ran.append(evaluate(*args, **how)))
    prepare._translate_sample(source, target)
    assert ran[0]["target_depth"].output.contact.any()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_no_kernel_is_left_to_compile_after_it(tmp_path):
    ours = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "user"),
    }
    command = [sys.executable, "-m", "pipeline", "prepare"]
    first = subprocess.run(command, cwd=ROOT, env=ours, capture_output=True, text=True, check=True)
    again = subprocess.run(command, cwd=ROOT, env=ours, capture_output=True, text=True, check=True)
    assert again.stdout == first.stdout.splitlines(keepends=True)[-1]
