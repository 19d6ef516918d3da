"""The gels' network by OpenCV answers as by torch, whole views and boxes, and refuses what does not fit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from pipeline.base.errors import ModelMissing
from pipeline.networks import network_factory, weights_registry
from pipeline.networks.gel_depth_opencv import GelDepthNetworkOpenCv
from pipeline.networks.weights import Weights


def seen(inputs, rows=120, cols=160):
    """Fields of the size that a network is shown, with a contact in them."""
    rng = np.random.default_rng(3)
    fields = rng.normal(scale=0.5, size=(inputs, rows, cols)).astype(np.float32)
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    bump = np.exp(-((x - cols / 2) ** 2 + (y - rows / 2) ** 2) / 300.0)
    fields[8], fields[9], fields[10], fields[11] = 0.3 * bump, -0.2 * bump, bump, bump > 0.3
    return fields


@pytest.mark.parametrize(
    ("name", "size"), [("gel_instances", (120, 160)), ("gel_depth", (120, 160)), ("gel_depth", (48, 56))]
)
def test_it_answers_as_by_torch(name, size):
    weights = weights_registry.load_shipped(name)
    assert isinstance(weights, Weights)
    light, net = network_factory.load_predictor(weights), network_factory.load_network(weights)
    assert isinstance(light, GelDepthNetworkOpenCv)
    fields = seen(light.inputs, *size)
    with torch.inference_mode():
        wanted = net(torch.from_numpy(fields)[None])
    found = light(fields)
    for here, there in ((found.correction, wanted.correction), (found.contact_logit_correction, wanted.contact_logit_correction),
                        (found.log_error_scale, wanted.log_error_scale)):  # fmt: skip
        assert here.dtype == np.float32
        assert np.abs(here - there[0].numpy()).max() < 2e-5 * max(1.0, float(there.abs().max()))
    assert (found.log_depth_factor is None) == (wanted.log_depth_factor is None) == (not light.predicts_depth_factor)
    if found.log_depth_factor is not None:
        assert found.log_depth_factor == pytest.approx(float(wanted.log_depth_factor[0]), abs=1e-5)


def test_weights_that_do_not_fit_are_one_sentence():
    whole = weights_registry.load_shipped("gel_depth")
    assert isinstance(whole, Weights)
    less = {name: t for name, t in whole.tensors.items() if name != "body.finish.bias"}
    for tensors in (less, {**whole.tensors, "head": np.zeros(3, np.float32)}):
        bad = Weights(name="w", kind=whole.kind, config=whole.config, tensors=tensors)
        with pytest.raises(ModelMissing, match=r"the weights 'w' do not fit the network 'gel_depth': 1 tensors"):
            network_factory.load_predictor(bad)


def test_reading_a_gel_loads_no_torch():
    """A second that a first touch need not take."""
    code = """
import sys
import numpy as np
from pipeline.physics import gel, optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.stage import NETWORK
from pipeline.values.frames import TactileFrame
mini = load_sensor("gelsight_mini")
rows, cols = mini.camera.shape
y, x = np.ogrid[:rows, :cols]
ball = 0.6 - mini.pixel_mm ** 2 * ((x - cols / 2) ** 2 + (y - rows / 2) ** 2) / 8
pressed = gel.press_gel(mini.gel, mini.pixel_mm, ball.astype(np.float32))
frame = TactileFrame(sensor=mini.name, image=optics.render(mini, pressed.indentation_mm, seed=1),
                     reference=optics.render_reference(mini))
class Silent:
    def step(self, fraction, text): pass
found = NETWORK.run(frame, mini, None, NETWORK.weights(mini, mini, None), NETWORK.params(), Silent())
assert found.expected_error_mm is not None and found.indentation_mm.max() > 0.3
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
