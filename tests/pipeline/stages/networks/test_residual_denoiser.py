"""The residual denoiser: noise level and condition have an effect."""

from __future__ import annotations

import pytest
import torch

from pipeline.stages.networks.residual_denoiser import FIELD_LIMIT, ResidualDenoiser


def small(seed=0, scale=0.3, levels=2):
    """A network with a random last layer; the initial one adds nothing."""
    torch.manual_seed(seed)
    net = ResidualDenoiser(
        inputs=3,
        unit_mm=1.0,
        base_channels=8,
        levels=levels,
        max_channels=16,
    ).eval()
    torch.nn.init.normal_(net.finish.weight, std=scale)
    for part in net.modules():
        if hasattr(part, "tune"):
            torch.nn.init.normal_(part.tune.weight, std=0.1)
    return net


@pytest.mark.parametrize("size", [(24, 32), (23, 17)])
def test_outputs_have_the_input_size_and_stay_within_the_limit(size):
    net = small()
    condition = torch.randn(2, 3, *size)
    with torch.inference_mode():
        for sigma in (0.001, 0.02, 1.0, 8.0, 200.0):
            answer = net(sigma * torch.randn(2, 2, *size), torch.full((2,), sigma), condition)
            assert answer.shape == (2, 3, *size)
            assert torch.isfinite(answer).all()
            assert answer[:, :2].abs().max() <= FIELD_LIMIT


def test_an_untrained_network_adds_nothing():
    net = ResidualDenoiser(inputs=3, unit_mm=1.0, base_channels=8, levels=2, max_channels=16).eval()
    assert not net(torch.randn(1, 2, 16, 16), torch.ones(1), torch.randn(1, 3, 16, 16)).any()


def test_noise_level_and_condition_change_the_output():
    net = small()
    noisy = torch.randn(1, 2, 16, 16)
    condition = torch.randn(1, 3, 16, 16)
    with torch.inference_mode():
        plain = net(noisy, torch.ones(1), condition)
        assert not torch.allclose(plain, net(noisy, torch.full((1,), 4.0), condition), atol=1e-3)
        assert not torch.allclose(plain, net(noisy, torch.ones(1), 0 * condition), atol=1e-3)


def test_a_single_field_and_a_batch_give_equal_outputs():
    net = small()
    noisy = torch.randn(2, 2, 23, 17)
    condition = torch.randn(2, 3, 23, 17)
    for part in net.modules():
        if isinstance(part, torch.nn.BatchNorm2d):
            part.running_mean.normal_()
            part.running_var.uniform_(0.5, 2.0)
            torch.nn.init.normal_(part.weight)
            torch.nn.init.normal_(part.bias)
    sigma = torch.tensor([0.5, 3.0])
    with torch.inference_mode():
        both = net(noisy, sigma, condition)
        for k in range(2):
            assert torch.allclose(
                net(noisy[k : k + 1], sigma[k : k + 1], condition[k : k + 1])[0], both[k], atol=1e-4
            )
