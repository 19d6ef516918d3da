"""The recordings that methods are scored on, kept in the user's cache."""

from __future__ import annotations

import pytest

from pipeline.base.progress import SILENT
from pipeline.evaluation import held_out
from pipeline.simulation import recorder
from pipeline.simulation.datasets import SimulationPlan


@pytest.mark.parametrize("content", [b"", b"\0" * 4096, b"\x89HDF\r\n\x1a\n cut short"])
def test_a_damaged_recording_of_the_cache_is_put_aside_and_simulated_again(tmp_path, monkeypatch, content):
    monkeypatch.setattr(recorder, "record", lambda plan, path, progress: path.write_bytes(b"simulated"))
    plan = SimulationPlan(sensors=("soft_bubble",), object_source="sphere", n_poses=1, seed=3)
    path = held_out._recorded("usual", plan, tmp_path, SILENT)
    path.write_bytes(content)
    assert held_out._recorded("usual", plan, tmp_path, SILENT) == path
    assert path.read_bytes() == b"simulated"
    assert sorted(p.read_bytes() for p in tmp_path.iterdir()) == sorted([content, b"simulated"])
