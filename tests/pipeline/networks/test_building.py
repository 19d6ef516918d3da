"""From weights to a network: ready to answer, kept, and refused in one sentence where the two do not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.base.errors import ModelMissing
from pipeline.networks.network_factory import NETWORK_CLASSES, build_network, load_network
from pipeline.networks.weights import NoWeights, Weights

CONFIG = {"inputs": 2, "outputs": 3, "base_channels": 4, "levels": 2}


@pytest.fixture
def weights():
    torch.manual_seed(0)
    net = build_network("compact_unet", CONFIG)
    tensors = {name: t.float().numpy().copy() for name, t in net.state_dict().items()}
    return Weights(name="w", kind="compact_unet", config=CONFIG, tensors=tensors)


def test_a_network_answers_by_its_weights_and_is_kept(weights):
    net = load_network(weights)
    assert not net.training
    assert not any(p.requires_grad for p in net.parameters())
    torch.manual_seed(0)
    same, x = build_network("compact_unet", CONFIG).eval(), torch.randn(1, 2, 12, 10)
    # Kept channels innermost, which adds up in another order.
    torch.testing.assert_close(net(x), same(x), rtol=1e-5, atol=1e-6)
    assert load_network(weights) is net
    bias = next(name for name in weights.tensors if name.endswith("bias"))
    other = {**weights.tensors, bias: weights.tensors[bias] + 1}
    assert load_network(replace(weights, tensors=other)) is not net


def test_weights_that_do_not_fit_are_one_sentence(weights):
    name = sorted(weights.tensors)[0]
    less = {key: t for key, t in weights.tensors.items() if key != name}
    with pytest.raises(ModelMissing, match=f"'w' do not fit the network 'compact_unet': 1 tensors .* '{name}'"):
        load_network(replace(weights, tensors=less))
    with pytest.raises(ModelMissing, match="do not fit"):
        load_network(replace(weights, tensors={**less, name: np.zeros((7, 7), np.float32)}))
    with pytest.raises(ModelMissing, match=r"cannot be built so .*heads"):
        load_network(replace(weights, config={**CONFIG, "heads": 3}))
    with pytest.raises(ModelMissing, match="no network 'unheard' in this version; there are "):
        load_network(replace(weights, kind="unheard"))
    with pytest.raises(ModelMissing, match="nothing here"):
        load_network(NoWeights(why="nothing here"))


@pytest.mark.parametrize("kind", sorted(NETWORK_CLASSES))
def test_every_kind_that_is_named_is_there(kind):
    with pytest.raises(ModelMissing, match="cannot be built so"):
        build_network(kind, {"an argument that none has": 1})
