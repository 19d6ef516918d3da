"""Nodes of a gel's depth are repeated only where they read what changed.

Drafts are marked in all that rests on them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.core.graph import Graph, Method
from pipeline.io import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import photometric
from pipeline.stages.depth.gel.settings import LIGHT
from pipeline.stages.depth.stage import PHYSICS

TOUCHED = 5


@pytest.fixture(scope="module")
def frame():
    return open_recording(SAMPLE_RECORDING, sensor="gelslim").stream("gelslim").frame(TOUCHED)


def test_settings_do_not_change_the_light(frame):
    graph = Graph((PHYSICS,))
    inputs = {"frame": frame, "source": load_sensor("gelslim"), "calibration": None}
    results = [
        graph.evaluate(("depth",), inputs, {"depth": params})["depth"]
        for params in (photometric.DepthParams(sensitivity=1.2), photometric.DepthParams())
    ]
    names = [node.name for node in results[0].nodes]
    assert names == [
        f"depth.{name}" for name in ("rest", "change", "light", "slopes", "surface", "contact")
    ]
    assert [node.state for node in results[1].nodes[1:3]] == ["unchanged", "unchanged"]
    assert results[0].nodes[2].digest == results[1].nodes[2].digest


def test_a_changed_parameter_of_the_contact_repeats_the_contact_alone(frame):
    graph = Graph((PHYSICS,))
    inputs = {"frame": frame, "source": load_sensor("gelslim"), "calibration": None}
    graph.evaluate(("depth",), inputs, {})
    again = graph.evaluate(
        ("depth",), inputs, {"depth": photometric.DepthParams(pressure_share=0.4)}
    )["depth"]
    assert [node.state for node in again.nodes[1:]] == [*["unchanged"] * 4, "computed"]


def test_a_frame_can_be_cancelled_at_every_iteration(frame):
    fractions = []

    class Recorder:
        def step(self, fraction, text):
            fractions.append(fraction)

    photometric.estimate_depth(
        frame, load_sensor("gelslim"), None, photometric.DepthParams(), Recorder()
    )
    assert len(fractions) > LIGHT.iterations + 4
    assert fractions == sorted(fractions)


@dataclass(frozen=True)
class Params:
    draft: bool = False


def test_what_rests_on_a_draft_is_a_draft():
    def make_method(stage, *reads):
        return Method(
            stage=stage, name="m", title=stage, run=lambda *_: stage, params=Params, reads=reads
        )

    graph = Graph(
        (make_method("a"), make_method("b", "a"), make_method("c", "b"), make_method("d", "a"))
    )
    results = graph.evaluate("abcd", {}, {"b": Params(draft=True)})
    assert {name: result.draft for name, result in results.items()} == {
        "a": False,
        "b": True,
        "c": True,
        "d": False,
    }
    again = graph.evaluate("abcd", {}, {"b": replace(Params(), draft=False)})
    assert not any(result.draft for result in again.values())
