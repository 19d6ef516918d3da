"""The compact U-Net by OpenCV answers as by torch, for pictures of any size, and refuses what does not fit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from pipeline.base.errors import ModelMissing
from pipeline.networks import network_factory
from pipeline.networks.compact_unet_opencv import CompactUnetOpenCv
from pipeline.networks.network_factory import build_network
from pipeline.networks.weights import Weights
from pipeline.stages.depth.bubble_network_output import N_OUTPUTS, decode_prediction, decode_tensors

CONFIG = {"inputs": 2, "outputs": 3, "base_channels": 8, "levels": 3, "max_channels": 12}


def learned(config=CONFIG):
    """Weights with something in every tensor, and the network of them."""
    torch.manual_seed(1)
    net = build_network("compact_unet", config)
    for name, tensor in net.state_dict().items():
        if tensor.is_floating_point() and not name.endswith(("0.weight", "thin.0.weight")):
            tensor.copy_(torch.rand_like(tensor) + 0.5)
    tensors = {name: t.float().numpy().copy() for name, t in net.state_dict().items()}
    return Weights(name="w", kind="compact_unet", config=config, tensors=tensors), net.eval()


@pytest.mark.parametrize("size", [(32, 40), (31, 37), (18, 22)])
@pytest.mark.parametrize("fold", [1, 2])
def test_it_answers_as_by_torch(size, fold):
    weights, net = learned({**CONFIG, "fold": fold})
    picture = np.random.default_rng(0).normal(size=(2, *size)).astype(np.float32)
    with torch.inference_mode():
        wanted = net(torch.from_numpy(picture[None]))[0].numpy()
    answer = network_factory.load_predictor(weights)(picture)
    assert isinstance(network_factory.load_predictor(weights), CompactUnetOpenCv)
    assert answer.shape == (3, *size)
    assert np.abs(answer - wanted).max() < 1e-5 * np.abs(wanted).max()


def test_what_it_says_of_a_bubble_means_to_its_user_what_it_means_to_its_teacher():
    rng = np.random.default_rng(2)
    answer, smooth = (rng.normal(scale=20.0, size=(n, 6, 7)).astype(np.float32) for n in (N_OUTPUTS, 1))
    taught, used = (
        decode_tensors(torch.from_numpy(answer[None]), torch.from_numpy(smooth[None])),
        decode_prediction(answer, smooth[0]),
    )
    np.testing.assert_allclose(used.displacement_mm, taught.displacement_mm[0])
    np.testing.assert_allclose(used.object_displacement_mm, taught.object_displacement_mm[0], atol=1e-5)
    np.testing.assert_allclose(used.expected_error_mm, taught.log_error[0].exp(), rtol=1e-5)
    np.testing.assert_allclose(used.contact, taught.contact[0].sigmoid(), atol=1e-6)
    np.testing.assert_allclose(used.object_in_view, taught.object_in_view[0].sigmoid(), atol=1e-6)


def test_weights_that_do_not_fit_are_one_sentence():
    weights, _ = learned()
    without = {name: t for name, t in weights.tensors.items() if name != "thin.1.bias"}
    less = Weights(name="w", kind="compact_unet", config=CONFIG, tensors=without)
    with pytest.raises(ModelMissing, match=r"'w' do not fit the network 'compact_unet': 1 tensors .* 'thin.1.bias'"):
        network_factory.load_predictor(less)
    other = Weights(name="w", kind="compact_unet", config={**CONFIG, "heads": 3}, tensors=weights.tensors)
    with pytest.raises(ModelMissing, match=r"do not fit .*heads"):
        network_factory.load_predictor(other)


def test_reading_a_bubble_loads_no_torch():
    """Two hundred megabytes and two seconds that a window need not take."""
    code = """
import sys
import numpy as np
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.stage import NETWORK
from pipeline.values.frames import TactileFrame
bubble = load_sensor("soft_bubble")
rest = bubble.rest_depth_mm.astype(np.float32)
weights = NETWORK.weights(bubble, load_sensor("gelslim"), None)
frame = TactileFrame(sensor="soft_bubble", image=rest - 2, reference=rest)
class Silent:
    def step(self, fraction, text): pass
assert NETWORK.run(frame, bubble, None, weights, NETWORK.params(), Silent()).indentation_mm.max() > 1
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
