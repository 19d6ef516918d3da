"""Fixtures of the training tests."""

from __future__ import annotations

import pytest

from pipeline.lab.training import task
from pipeline.stages.networks import network_factory
from tests.pipeline.lab.training import toy


@pytest.fixture(autouse=True)
def _toys(monkeypatch):
    monkeypatch.setitem(task.TASKS, "discs", None)
    monkeypatch.setitem(network_factory.NETWORK_CLASSES, "toy_net", "")
    toy.register()


@pytest.fixture
def recipe_file(tmp_path):
    path = tmp_path / "discs.toml"
    path.write_text(toy.RECIPE)
    return path


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    import torch

    torch.set_num_threads(1)
