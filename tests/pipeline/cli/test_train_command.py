"""`tactoscope train`: from a recipe to weights with their card, and what it says where that
cannot be.
"""

from __future__ import annotations

import json

import pytest

from pipeline.cli.main import EXIT_INTERRUPTED, EXIT_USER_ERROR, build_app, run_app
from pipeline.lab.training import task
from pipeline.stages.networks import network_factory
from pipeline.stages.networks.weights import load_weights
from tests.pipeline.lab.training import toy


@pytest.fixture
def typed(monkeypatch, tmp_path, capsys):
    """Train the toy with these words; returns exit code, stdout and stderr."""
    monkeypatch.setitem(task.TASKS, "discs", None)
    monkeypatch.setitem(network_factory.NETWORK_CLASSES, "toy_net", "")
    toy.register()
    (tmp_path / "discs.toml").write_text(toy.RECIPE)

    def go(*words):
        code = run_app(build_app(), ["train", *(str(word) for word in words)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return go


def test_a_training_ends_in_weights_with_a_card_and_can_be_exported_smaller(typed, tmp_path):
    out = tmp_path / "out"
    asked = (
        "discs",
        "--recipe",
        tmp_path / "discs.toml",
        "--out",
        out,
        "--steps",
        30,
        "--seed",
        5,
        "--workers",
        0,
    )
    code, said, _ = typed(*asked)
    assert code == 0
    assert "unseen tools: overlap, 1" in said
    weights = load_weights(out / "weights.safetensors")
    assert (weights.kind, weights.config) == ("toy_net", {"width": 4})
    assert weights.card["examples seen"] == "120"
    assert json.loads(weights.card["recipe"])["training"]["seed"] == 5
    assert {
        "task",
        "command",
        "minutes",
        "machine",
        "unseen grasps: overlap, 1",
    } <= weights.card.keys()
    assert "| steps | 30 |\n" in (out / "weights.md").read_text()
    code, said, _ = typed("export", out, "--to", tmp_path / "half.safetensors", "--half")
    assert code == 0
    assert (tmp_path / "half.safetensors").stat().st_size < (
        out / "weights.safetensors"
    ).stat().st_size
    assert load_weights(tmp_path / "half.safetensors").card == weights.card
    code, _, said = typed(*asked)
    assert (code, "give --resume" in said) == (EXIT_USER_ERROR, True)
    assert typed(*asked, "--resume")[0] == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--minutes", "3", "--steps", "4"), "give either --minutes or --steps, not both"),
        (("--minutes", "0"), "--minutes must lie above 0"),
        (("--minutes", "nan"), "--minutes must lie above 0"),
        (("--steps", "0"), "steps must lie within 1 and"),
        (("--seed", "-1"), "seed must lie within 0 and"),
        (("--share", "0.1"), "--share needs --pairs"),
        (("--share", "2", "--pairs", "x.h5"), "share must lie within 0.001 and 1, got 2"),
        (("--from", "nowhere"), "no weights 'nowhere' are shipped"),
        (("--workers", "99"), "--workers must lie within 0 and 64"),
    ],
)
def test_options_that_cannot_be_are_one_sentence(typed, tmp_path, words, sentence):
    code, _, said = typed(
        "discs", "--recipe", tmp_path / "discs.toml", "--out", tmp_path / "out", *words
    )
    assert code == EXIT_USER_ERROR
    assert sentence in said
    assert not (tmp_path / "out" / "state.pt").exists()


def test_what_is_no_training_cannot_be_exported(typed, tmp_path):
    code, _, said = typed("export", tmp_path, "--to", tmp_path / "a.safetensors")
    assert (code, "holds no training run" in said) == (EXIT_USER_ERROR, True)
    code, _, said = typed("export", tmp_path, "--to", tmp_path / "a.pt")
    assert (code, "choose such a name" in said) == (EXIT_USER_ERROR, True)


def test_ctrl_c_keeps_all_that_was_learned(typed, tmp_path, monkeypatch):
    import signal

    sample = toy.Discs.sample
    count = iter(range(1000))

    def interrupted(self, rng):
        if next(count) == 50:
            signal.raise_signal(signal.SIGINT)
        return sample(self, rng)

    monkeypatch.setattr(toy.Discs, "sample", interrupted)
    asked = (
        "discs",
        "--recipe",
        tmp_path / "discs.toml",
        "--out",
        tmp_path / "out",
        "--workers",
        0,
    )
    assert typed(*asked)[0] == EXIT_INTERRUPTED
    assert typed(*asked, "--resume")[0] == 0
    assert load_weights(tmp_path / "out" / "weights.safetensors").card["steps"] == "60"
