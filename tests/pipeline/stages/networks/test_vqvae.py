from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.core.errors import FileProblem
from pipeline.stages.networks import published_weights, weights_registry
from pipeline.stages.networks.network_factory import build_network, load_network
from pipeline.stages.networks.vqvae import VqVae
from pipeline.stages.networks.weights import NoWeights

SMALL = {"inputs": 3, "outputs": 1, "width": 8, "codes": 16}


def small(seed=0, **other):
    torch.manual_seed(seed)
    return VqVae(**{**SMALL, **other})


def test_the_published_configuration_has_the_released_tensors():
    with torch.device("meta"):
        shapes = {name: tuple(t.shape) for name, t in VqVae().state_dict().items()}
    assert shapes["encoder.0.weight"] == (256, 3, 4, 4)
    assert shapes["encoder.2.weight"] == (256, 256, 4, 4)
    assert shapes["encoder.4.block.3.weight"] == (256, 256, 1, 1)
    assert shapes["codebook.embedding.weight"] == (16_385, 256)
    assert shapes["decoder.1.block.1.bias"] == (256,)
    assert shapes["decoder.3.weight"] == (256, 256, 4, 4)
    assert shapes["decoder.5.weight"] == (256, 1, 4, 4)
    assert len(shapes) == 25


def test_a_residual_block_adds_to_its_activated_input():
    """The released blocks work in place: their first ReLU changes what the sum adds to."""
    block = small().encoder[3]
    field = torch.randn(1, 8, 6, 6)
    inner = block.block(field)
    assert torch.allclose(block(field), torch.relu(field) + inner, atol=1e-6)


def test_positions_take_the_nearest_code_and_gradients_pass_straight_through():
    net = small().train()
    net.codebook.embedding.weight.data.normal_()
    x = torch.randn(2, 3, 16, 16, requires_grad=True)
    found = net(x)
    gaps = (
        (found.encoded[:, :, None] - net.codebook.embedding.weight.T[None, :, :, None, None])
        .pow(2)
        .sum(1)
    )
    nearest_codes = net.codebook.embedding.weight[gaps.argmin(1)].permute(0, 3, 1, 2)
    assert torch.allclose(found.quantised, nearest_codes)
    found.generated.sum().backward()
    assert x.grad.abs().sum() > 0


def test_only_a_new_codebook_is_initialised_from_the_batch():
    net = small().train()
    x = torch.randn(4, 3, 32, 32)
    found = net(x)
    assert (
        len(
            torch.unique(
                net.codebook.assign_codes(found.encoded.permute(0, 2, 3, 1).reshape(-1, 8))
            )
        )
        > 4
    )
    before = net.codebook.embedding.weight.detach().clone()
    net(x[:1])  # too few places to tell that an entry is not used
    assert torch.equal(net.codebook.embedding.weight.detach(), before)


def test_only_unused_entries_are_replaced():
    net = small().train()
    entries = net.codebook.embedding.weight
    with torch.no_grad():
        entries.normal_()
        entries[5:] = 100.0  # as far off as a codebook falls together
    before = entries.detach().clone()
    encoded = torch.randn(4, 8, 16, 16)
    net.codebook(encoded)
    assert torch.equal(entries[:5].detach(), before[:5])
    rows = encoded.permute(0, 2, 3, 1).reshape(-1, 8)
    assert (torch.cdist(entries[5:].detach(), rows).min(1).values < 1e-3).all()
    assert len(torch.unique(net.codebook.eval().assign_codes(rows))) > 10


def test_a_position_bias_makes_the_output_depend_on_position():
    """A constant source gives a constant output without it."""
    still = torch.zeros(1, 3, 128, 128)
    plain = small()
    placed = small(has_position_bias=True)
    with torch.no_grad():
        placed.position_bias.normal_()
    inner = slice(40, 88)
    answers = [net.eval()(still).generated[0, 0, inner, inner] for net in (plain, placed)]
    assert answers[0][:, ::4].std(dim=1).max() < 1e-5 < answers[1][:, ::4].std(dim=1).max()


def test_dilation_widens_the_receptive_field():
    def seen(net):
        x = torch.randn(1, 3, 128, 128, requires_grad=True)
        net.eval().decoder(net.encoder(x))[0, 0, 64, 64].backward()
        return int((x.grad[0].abs().sum(dim=(0, 1)) > 0).sum())

    assert seen(small()) < 64
    assert seen(small(dilation=4)) > 90


def test_a_released_state_is_recognised_by_its_tensors(tmp_path):
    net = small(codes=33)
    torch.save(net.state_dict(), tmp_path / "best.pt")
    found = published_weights.read_vqvae(tmp_path / "best.pt")
    assert dict(found.config) == {
        "inputs": 3,
        "outputs": 1,
        "width": 8,
        "codes": 33,
        "half_turn": True,
    }
    x = torch.randn(1, 3, 16, 16)
    assert torch.allclose(load_network(found)(x).generated, net.eval()(x).generated, atol=1e-6)


def test_other_files_are_refused(tmp_path):
    torch.save({"weight": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(FileProblem, match=r"encoder\.0\.weight"):
        published_weights.read_vqvae(tmp_path / "other.pt")
    assert isinstance(
        weights_registry.load_file(tmp_path / "other.pt", published_weights.read_vqvae), NoWeights
    )


@pytest.mark.slow
def test_the_published_configuration_can_be_trained():
    torch.manual_seed(1)
    net = build_network("vqvae", {"inputs": 3, "outputs": 1}).train()
    optimiser = torch.optim.Adam(net.parameters(), 2e-4)
    x = torch.randn(1, 3, 128, 128)
    target = x.mean(1, keepdim=True)
    losses = []
    for _ in range(4):
        found = net(x)
        loss = (found.generated - target).pow(2).mean() + (
            found.quantised - found.encoded.detach()
        ).pow(2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0]
    assert np.isfinite(losses).all()
