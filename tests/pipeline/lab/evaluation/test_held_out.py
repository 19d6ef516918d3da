"""Cached recordings of the held-out touches."""

from __future__ import annotations

import pytest

from pipeline.core.progress import SILENT
from pipeline.lab import recorder
from pipeline.lab.evaluation import held_out
from pipeline.physics.simulation.datasets import SimulationPlan


@pytest.mark.parametrize("content", [b"", b"\0" * 4096, b"\x89HDF\r\n\x1a\n cut short"])
def test_a_damaged_cached_recording_is_set_aside_and_simulated_again(
    tmp_path, monkeypatch, content
):
    monkeypatch.setattr(
        recorder, "record_plan", lambda plan, path, progress: path.write_bytes(b"simulated")
    )
    plan = SimulationPlan(sensors=("soft_bubble",), object_source="sphere", n_poses=1, seed=3)
    path = held_out._load_or_record("training", plan, tmp_path, SILENT)
    path.write_bytes(content)
    assert held_out._load_or_record("training", plan, tmp_path, SILENT) == path
    assert path.read_bytes() == b"simulated"
    assert sorted(p.read_bytes() for p in tmp_path.iterdir()) == sorted([content, b"simulated"])
