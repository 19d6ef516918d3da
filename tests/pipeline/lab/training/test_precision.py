"""Networks in 16 bits give output in 32."""

from __future__ import annotations

import torch
from torch import nn

from pipeline.lab.training.precision import wrap_precision


def test_a_network_in_16_bits_has_output_and_gradients_in_32():
    class Two(nn.Module):
        def __init__(self):
            super().__init__()
            self.line = nn.Linear(4, 4)

        def forward(self, x):
            y = self.line(x)
            seen.append(y.dtype)
            return {"a": y, "b": (y, y > 0)}

    seen = []
    net = Two()
    x = torch.randn(3, 4)
    exact = net(x)["a"]
    rough = wrap_precision(net, "bf16")(x)
    assert seen == [torch.float32, torch.bfloat16]
    assert rough["a"].dtype == rough["b"][0].dtype == torch.float32
    assert rough["b"][1].dtype == torch.bool
    assert 0 < (rough["a"] - exact).abs().max() < 0.05
    rough["a"].sum().backward()
    assert net.line.weight.grad.dtype == torch.float32
    assert wrap_precision(net, "float32") is net
