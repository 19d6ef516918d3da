"""The gel depth network: integration of slopes, bounds of its correction, depth factor."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.networks.gel_depth import GelDepthNetwork, integrate_slopes

REACH = 10.0


def make_surface(rows=37, cols=50):
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    return torch.from_numpy(np.exp(-((x - 20) ** 2 + (y - 15) ** 2) / 60.0) + 0.02 * x)[None]


def compute_edge_slopes(z):
    """Slopes of pixels whose means over neighbours are the differences of neighbours, for a surface that allows it."""
    x, y = np.zeros_like(z), np.zeros_like(z)
    for k in range(1, z.shape[-1]):
        x[..., k] = 2 * (z[..., k] - z[..., k - 1]) - x[..., k - 1]
    for k in range(1, z.shape[-2]):
        y[..., k, :] = 2 * (z[..., k, :] - z[..., k - 1, :]) - y[..., k - 1, :]
    return torch.from_numpy(x), torch.from_numpy(y)


def test_slopes_and_a_rough_surface_that_agree_give_that_make_surface():
    z = make_surface()
    found = integrate_slopes(*compute_edge_slopes(z.numpy()), z, REACH)
    torch.testing.assert_close(found, z, atol=2e-4, rtol=0)


def test_slopes_give_the_short_waves_and_the_rough_surface_the_long_ones():
    z, nothing = make_surface(), torch.zeros(1, 37, 50)
    by_slopes = integrate_slopes(*compute_edge_slopes(z.numpy()), nothing, 1e4)
    torch.testing.assert_close(by_slopes - by_slopes.mean(), z - z.mean(), atol=2e-3, rtol=0)
    lifted = integrate_slopes(nothing, nothing, nothing + 3.0, REACH)
    torch.testing.assert_close(lifted, nothing + 3.0, atol=1e-4, rtol=0)


def test_the_gradient_of_one_height_reaches_slopes_everywhere():
    x = torch.zeros(1, 20, 30, requires_grad=True)
    integrate_slopes(x, torch.zeros(1, 20, 30), torch.zeros(1, 20, 30), REACH)[0, 10, 15].backward()
    assert x.grad is not None
    assert float(x.grad[0, 10].abs().min()) > 0


def make_network():
    return GelDepthNetwork(inputs=16, physics_channel=8, base_channels=8, levels=3, max_channels=16)


def test_an_untrained_network_returns_the_physical_surface():
    fields = torch.randn(2, 16, 24, 32)
    with torch.inference_mode():
        prediction = make_network().eval()(fields)
    assert {tuple(field.shape) for field in prediction[:-1]} == {(2, 24, 32)}
    assert all(field.dtype is torch.float32 for field in prediction)
    assert prediction.log_depth_factor.tolist() == [0.0, 0.0]
    assert torch.equal(prediction.surface, fields[:, 10])
    assert torch.equal(prediction.contact_logit > 0, fields[:, 11] > 0.5)
    assert not prediction.correction.any()
    assert not prediction.contact_logit_correction.any()


def test_the_correction_is_bounded_by_a_share_of_the_height():
    wild, fields = make_network().eval(), torch.randn(2, 16, 24, 32)
    torch.nn.init.normal_(wild.body.finish.weight, std=30.0)
    with torch.inference_mode():
        correction = wild(fields).correction.abs()
    assert float(correction[fields[:, 10] <= 0].max()) <= 0.0801
    assert bool((correction <= 0.0801 + 0.35 * fields[:, 10].clamp(0.0, 1.5)).all())
    assert float(correction.max()) > 0.3


def test_gradients_reach_the_last_layer():
    network = make_network().train()
    network(torch.randn(2, 16, 24, 32)).surface.square().mean().backward()
    assert float(network.body.finish.weight.grad.abs().max()) > 0


def test_the_depth_factor_is_the_mean_over_the_contact():
    torch.manual_seed(2)
    network = make_network().eval()
    fields = torch.randn(2, 16, 24, 32)
    fields[:, 11] = 0.0
    fields[0, 11, 5:9, 10:20] = 1.0
    fields[1, 11, 15:, :8] = 1.0
    with torch.inference_mode():
        torch.nn.init.normal_(network.body.finish.weight, std=2.0)
        per_pixel = network.body(fields)[:, 6]
        factors = network(fields).log_depth_factor
        by_hand = [0.3 * float(per_pixel[k][fields[k, 11] > 0].mean()) for k in range(2)]
    assert factors.tolist() == pytest.approx(by_hand, rel=0.1, abs=0.01)
    assert float(factors[0]) != pytest.approx(float(factors[1]), abs=1e-3)
