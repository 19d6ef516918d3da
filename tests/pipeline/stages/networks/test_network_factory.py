"""Networks built from weights: usable, cached, and refused in one sentence where weights do not
fit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.errors import ModelMissing
from pipeline.stages.networks.network_factory import NETWORK_CLASSES, build_network, load_network
from pipeline.stages.networks.weights import NoWeights, Weights

CONFIG = {"inputs": 2, "outputs": 3, "base_channels": 4, "levels": 2}


@pytest.fixture
def weights():
    torch.manual_seed(0)
    net = build_network("compact_unet", CONFIG)
    tensors = {name: t.float().numpy().copy() for name, t in net.state_dict().items()}
    return Weights(name="w", kind="compact_unet", config=CONFIG, tensors=tensors)


def test_a_loaded_network_uses_its_weights_and_is_cached(weights):
    net = load_network(weights)
    assert not net.training
    assert not any(p.requires_grad for p in net.parameters())
    torch.manual_seed(0)
    same = build_network("compact_unet", CONFIG).eval()
    x = torch.randn(1, 2, 12, 10)
    # Channels-last convolutions sum in another order.
    torch.testing.assert_close(net(x), same(x), rtol=1e-5, atol=1e-6)
    assert load_network(weights) is net
    bias = next(name for name in weights.tensors if name.endswith("bias"))
    other = {**weights.tensors, bias: weights.tensors[bias] + 1}
    assert load_network(replace(weights, tensors=other)) is not net


def test_weights_that_do_not_fit_are_refused(weights):
    name = sorted(weights.tensors)[0]
    less = {key: t for key, t in weights.tensors.items() if key != name}
    with pytest.raises(
        ModelMissing, match=f"'w' do not fit the network 'compact_unet': 1 tensors .* '{name}'"
    ):
        load_network(replace(weights, tensors=less))
    with pytest.raises(ModelMissing, match="do not fit"):
        load_network(replace(weights, tensors={**less, name: np.zeros((7, 7), np.float32)}))
    with pytest.raises(ModelMissing, match=r"compact_unet.*heads"):
        load_network(replace(weights, config={**CONFIG, "heads": 3}))
    with pytest.raises(ModelMissing, match="'unknown'"):
        load_network(replace(weights, kind="unknown"))
    with pytest.raises(ModelMissing, match="no file"):
        load_network(NoWeights(why="no file"))


@pytest.mark.parametrize("kind", sorted(NETWORK_CLASSES))
def test_every_listed_network_class_exists(kind):
    with pytest.raises(ModelMissing, match=kind):
        build_network(kind, {"unknown argument": 1})
