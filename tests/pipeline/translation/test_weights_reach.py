"""Weights on their way to a method: from a file, from what comes along, or why another method
answers.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.arrays import freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.graph import Graph, Method
from pipeline.stages.depth.stage import PHYSICS
from pipeline.stages.networks import network_factory, weights_registry
from pipeline.stages.networks.network_factory import fall_back_without_weights
from pipeline.stages.networks.weights import NoWeights, Weights, save_weights
from pipeline.translation.catalogue import BUILT_IN, Catalogue, with_weights
from pipeline.translation.translate import Request, open_translation

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
TOUCH = 5


def scale(factor):
    import torch
    from torch import nn

    class Scale(nn.Module):
        def __init__(self):
            super().__init__()
            self.factor = nn.Parameter(torch.tensor([float(factor)]))

        def forward(self, x):
            return x * self.factor

    return Scale()


def scaled(frame, source, calibration, network, params, progress):
    import torch

    found = PHYSICS.run(frame, source, calibration, params, progress)
    found = getattr(found, "output", found)
    with torch.inference_mode():
        deep = network(torch.from_numpy(found.indentation_mm.copy())).numpy()
    return replace(found, indentation_mm=freeze(deep), notes=("by network",))


NETWORK = Method(
    stage="depth",
    name="scaled",
    title="Scaled",
    run=fall_back_without_weights(scaled, fallback=PHYSICS),
    params=PHYSICS.params,
    reads=(*PHYSICS.reads, "depth_weights"),
    weights=lambda source, target, file: weights_registry.load_for_task("toy", "toy", file),
)
DEPTH = replace(BUILT_IN.stage("depth"), methods=(PHYSICS, NETWORK))
CATALOGUE = Catalogue(
    stages=tuple(DEPTH if stage.name == "depth" else stage for stage in BUILT_IN.stages),
    routes=BUILT_IN.routes,
)


@pytest.fixture(autouse=True)
def _shelf(monkeypatch, tmp_path):
    monkeypatch.setitem(network_factory.NETWORK_CLASSES, "scale", f"{__name__}:scale")
    monkeypatch.setattr(weights_registry, "WEIGHTS_FOLDER", tmp_path / "shelf")


def weights(factor, task="toy"):
    tensors = {"factor": np.array([factor], np.float32)}
    return Weights(
        name="w", kind="scale", config={"factor": 1.0}, tensors=tensors, card={"task": task}
    )


def depth(method="scaled", graph=None, **more):
    methods = (("depth", method), ("touch", "physics"))
    request = Request(recording=SAMPLE, source="digit", target="gelslim", methods=methods, **more)
    with open_translation(request, CATALOGUE) as opened:
        return replace(opened, graph=graph or opened.graph).evaluate(TOUCH, ["depth"])[
            "depth"
        ], opened.notes


def test_a_file_is_read_and_what_it_holds_is_part_of_the_key(tmp_path):
    plain = depth("physics")[0].output
    file = tmp_path / "w.safetensors"
    save_weights(file, weights(2.0))
    twice = depth(weights=(("", file),))[0]
    np.testing.assert_allclose(twice.output.indentation_mm, 2.0 * plain.indentation_mm, rtol=1e-6)
    assert twice.notes == ("by network",)
    assert twice.fallback == ""
    graph = Graph(())
    assert depth(graph=graph, weights=(("depth", file),))[0].state == "computed"
    assert depth(graph=graph, weights=(("depth", file),))[0].state == "cached"
    save_weights(file, weights(3.0))
    again = depth(graph=graph, weights=(("depth", file),))[0]
    assert again.state == "computed"
    np.testing.assert_allclose(again.output.indentation_mm, 3.0 * plain.indentation_mm, rtol=1e-6)


def test_what_comes_along_is_read_where_no_file_is_given():
    save_weights(weights_registry.WEIGHTS_FOLDER / "toy.safetensors", weights(1.5))
    assert depth()[0].notes == ("by network",)


@pytest.mark.parametrize(
    "fault", ["missing", "cut", "foreign", "other task", "other shape", "nothing on the shelf"]
)
def test_without_usable_weights_physics_answers_and_the_first_note_says_why(tmp_path, fault):
    file = tmp_path / "w.safetensors"
    why = {
        "missing": "No such file",
        "cut": "truncated",
        "foreign": "name their network",
        "other task": "trained for gel",
        "other shape": "do not fit",
        "nothing on the shelf": "no weights 'toy' are shipped",
    }[fault]
    save_weights(file, weights(2.0, task="gel" if fault == "other task" else "toy"))
    if fault == "missing":
        file.unlink()
    elif fault == "cut":
        file.write_bytes(file.read_bytes()[:-2])
    elif fault == "foreign":
        from safetensors.numpy import save_file

        save_file({"x": np.zeros(3, np.float32)}, file)
    elif fault == "other shape":
        save_weights(file, replace(weights(2.0), tensors={"factor": np.zeros(2, np.float32)}))
    given = () if fault == "nothing on the shelf" else (("", file),)
    answered = depth(weights=given)[0]
    plain = depth("physics")[0]
    assert why in answered.notes[0]
    assert answered.fallback == answered.notes[0]
    assert answered.badge.startswith("physics:")
    assert answered.notes[1:] == plain.notes
    assert np.array_equal(answered.output.indentation_mm, plain.output.indentation_mm)


def test_weights_that_nobody_reads_are_told(tmp_path):
    notes = depth("physics", weights=(("", tmp_path / "w.safetensors"),))[1]
    assert any("'w.safetensors' count for nothing" in note for note in notes)
    notes = depth(weights=(("touch", tmp_path / "w.safetensors"),))[1]
    (note,) = (note for note in notes if "the method of touch reads none" in note)
    assert "touch=latent" in note
    assert "depth=" not in note


def test_a_file_may_be_given_for_a_stage_and_may_have_any_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert with_weights({}, "touch=a b.safetensors") == {"touch": Path("a b.safetensors")}
    assert with_weights({"touch": Path("t")}, "x.pth") == {"touch": Path("t"), "": Path("x.pth")}
    with pytest.raises(SettingProblem, match=r"run=3\.safetensors.*touch_depth"):
        with_weights({}, "run=3.safetensors")
    Path("run=3.safetensors").touch()
    assert with_weights({}, "run=3.safetensors") == {"": Path("run=3.safetensors")}


def test_a_command_refuses_weights_that_it_cannot_use(tmp_path):
    request = Request(
        recording=SAMPLE, source="gelslim", target="soft_bubble", methods=(("touch", "t2t"),)
    )
    damaged = tmp_path / "lab.safetensors"
    damaged.write_bytes(b"no tensors")
    named = replace(request, weights=(("touch", damaged),))
    with closing(open_translation(named)) as translation:
        assert any(
            isinstance(w, NoWeights) and "lab.safetensors" in w.why
            for w in translation.weights.values()
        )
    with pytest.raises(SettingProblem, match=r"touch.*lab\.safetensors"):
        open_translation(replace(named, refuses_unusable_weights=True))
