"""The scale-invariant loss equals the paper's and has a gradient where the published form has
none.
"""

from __future__ import annotations

import math

import pytest
import torch

from pipeline.lab.training.depth_anything import compute_silog_loss


def published(found, truth, share):
    apart = torch.log(truth) - torch.log(found)
    return torch.sqrt((apart**2).mean() - share * apart.mean() ** 2)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.85, 1.0])
def test_the_loss_equals_the_published_one(share):
    torch.manual_seed(0)
    found = torch.rand(1, 6, 7) + 0.2
    truth = torch.rand(1, 6, 7) + 0.2
    ours = compute_silog_loss(found, truth, torch.ones_like(truth), share=share, least=1e-3)
    assert float(ours) == pytest.approx(float(published(found, truth, share)), rel=1e-4)


def test_a_scale_factor_costs_less_with_a_larger_share():
    truth = torch.rand(1, 5, 5) + 0.5
    costs = [
        float(compute_silog_loss(3.0 * truth, truth, torch.ones_like(truth), share=s, least=1e-3))
        for s in (0.0, 0.75, 1.0)
    ]
    assert costs == pytest.approx([math.log(3.0), 0.5 * math.log(3.0), 1e-4], rel=1e-3)


@pytest.mark.parametrize("case", ["perfect", "nothing counted", "zeros", "negative"])
def test_value_and_gradient_are_numbers_everywhere(case):
    truth = torch.rand(2, 4, 4) + 0.1
    counted = torch.zeros_like(truth) if case == "nothing counted" else torch.ones_like(truth)
    start = {"zeros": torch.zeros_like(truth), "negative": -truth}.get(case, truth.clone())
    found = start.requires_grad_()
    loss = compute_silog_loss(found, truth, counted, share=1.0, least=0.01)
    loss.backward()
    loss = loss.detach()
    assert math.isfinite(float(loss))
    assert bool(torch.isfinite(found.grad).all())
    if case == "nothing counted":
        assert float(loss) == 0.0


def test_an_image_without_contact_does_not_count():
    torch.manual_seed(1)
    found = torch.rand(2, 4, 4) + 0.1
    truth = torch.rand(2, 4, 4) + 0.1
    counted = torch.ones_like(truth)
    counted[1] = 0.0
    both = compute_silog_loss(found, truth, counted, share=0.5, least=0.01)
    assert float(both) == pytest.approx(
        float(compute_silog_loss(found[:1], truth[:1], counted[:1], share=0.5, least=0.01))
    )
