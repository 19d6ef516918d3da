"""The compact U-Net: output of the input's size, at most a million parameters, a global
receptive field.
"""

from __future__ import annotations

import pytest
import torch

from pipeline.stages.networks.compact_unet import CompactUnet


@pytest.mark.parametrize("size", [(120, 160), (37, 53), (16, 16)])
def test_fields_have_the_size_of_the_image(size: tuple[int, int]) -> None:
    network = CompactUnet(inputs=3, outputs=2, base_channels=8, max_channels=32).eval()
    with torch.inference_mode():
        assert network(torch.zeros(2, 3, *size)).shape == (2, 2, *size)


def test_it_is_compact() -> None:
    network = CompactUnet(inputs=11, outputs=5)
    assert 3e5 < sum(p.numel() for p in network.parameters()) < 1e6


def test_a_corner_depends_on_the_opposite_one() -> None:
    torch.manual_seed(0)
    network = CompactUnet(inputs=1, outputs=1, base_channels=8, max_channels=32).eval()
    image = torch.rand(1, 1, 96, 96, requires_grad=True)
    network(image)[0, 0, 0, 0].backward()
    assert image.grad is not None
    assert float(image.grad[0, 0, -16:, -16:].abs().sum()) > 0
