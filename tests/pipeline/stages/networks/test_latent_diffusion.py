from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.core.errors import FileProblem
from pipeline.stages.networks import published_weights
from pipeline.stages.networks.autoencoder_kl import sample_latents
from pipeline.stages.networks.latent_diffusion import LatentDiffusion, compute_alphas_cumprod
from pipeline.stages.networks.network_factory import build_network, load_network

SMALL = {
    "side": 32,
    "width": 8,
    "channel_multipliers": "1 2",
    "blocks": 1,
    "attention": "2",
    "heads": 2,
    "groups": 4,
    "autoencoder_width": 8,
    "autoencoder_multipliers": "1 1 2 2",
    "autoencoder_blocks": 1,
    "condition_channels": 4,
}


def small(seed=0, **other):
    torch.manual_seed(seed)
    return LatentDiffusion(**{**SMALL, **other})


def batch(n=2, side=32):
    torch.manual_seed(1)
    return {
        "target": torch.tanh(torch.randn(n, 3, side, side)),
        "source": torch.randn(n, 3, side, side),
        "time": torch.tensor([10, 900][:n]),
        "has_condition": torch.ones(n),
        "noises": torch.randn(2, n, 4, side // 8, side // 8),
    }


def paper():
    with torch.device("meta"):
        return LatentDiffusion()


def test_the_published_configuration_has_the_published_tensors():
    """Names, shapes and counts of the released configuration: 295.08 million parameters in 520
    tensors.
    """
    shapes = {name: tuple(t.shape) for name, t in paper().state_dict().items()}
    unet = {
        n.removeprefix("model.diffusion_model."): s
        for n, s in shapes.items()
        if n.startswith("model.diffusion")
    }
    assert len(unet) == 520
    assert round(sum(int(np.prod(s)) for s in unet.values()) / 1e6, 2) == 295.08
    assert unet["input_blocks.0.0.weight"] == (192, 68, 3, 3)
    assert unet["input_blocks.1.1.qkv.weight"] == (576, 192, 1)
    assert unet["input_blocks.3.0.emb_layers.1.weight"] == (384, 768)
    assert unet["output_blocks.2.1.in_layers.2.weight"] == (768, 768, 3, 3)
    assert unet["out.2.weight"] == (4, 192, 3, 3)
    assert shapes["first_stage_model.encoder.down.1.block.0.nin_shortcut.weight"] == (
        256,
        128,
        1,
        1,
    )
    assert shapes["first_stage_model.decoder.up.3.block.2.conv2.weight"] == (512, 512, 3, 3)
    assert shapes["first_stage_model.decoder.mid.attn_1.proj_out.bias"] == (512,)
    assert shapes["first_stage_model.quant_conv.weight"] == (8, 8, 1, 1)
    assert shapes["cond_stage_model.resnet.layer4.0.downsample.0.weight"] == (512, 256, 1, 1)
    assert shapes["cond_stage_model.deconv2.weight"] == (256, 64, 4, 4)
    assert shapes["scale_factor"] == ()


def test_the_noise_schedule_is_the_published_one():
    alphas = compute_alphas_cumprod()
    assert alphas[0] == pytest.approx(1 - 0.0015)
    assert alphas[-1] == pytest.approx(alphas[-2] * (1 - 0.0155))
    assert (np.diff(alphas) < 0).all()


def test_images_are_encoded_to_an_eighth_and_decoded():
    net = small().eval()
    mean, log_variance = net.first_stage_model.encode(batch()["target"])
    assert mean.shape == log_variance.shape == (2, 4, 4, 4)
    assert net.decode_images(mean).shape == (2, 3, 32, 32)


def test_the_noise_loss_has_no_gradients_in_the_autoencoder():
    net = small().train()
    found = net(**batch())
    (found.predicted_noise - found.true_noise).abs().mean().backward()
    assert all(p.grad is None for p in net.first_stage_model.parameters())
    assert any(p.grad is not None for p in net.cond_stage_model.parameters())


def test_autoencoder_and_denoiser_can_be_trained_separately():
    net = small().train()
    found = net(**batch(), part="autoencoder")
    assert found.predicted_noise is None
    found.reconstruction.mean().backward()
    assert all(p.grad is None for p in net.model.parameters())
    net.zero_grad()
    scale = net.scale_factor.clone()
    found = net(**batch(), part="denoiser")
    assert found.reconstruction is None
    found.predicted_noise.abs().mean().backward()
    assert all(p.grad is None for p in net.first_stage_model.parameters())
    assert torch.equal(net.scale_factor, scale)


def test_a_folded_condition_keeps_every_pixel_in_its_cell():
    net = small(condition_encoder="fold", condition_inputs=2).eval()
    assert not [name for name in net.state_dict() if name.startswith("cond_stage_model")]
    image = torch.zeros(1, 2, 32, 32)
    image[0, 1, 9, 18] = 1.0
    folded = net.cond_stage_model(image)
    assert folded.shape == (1, 128, 4, 4)
    assert folded.nonzero().tolist() == [[0, 64 + 1 * 8 + 2, 1, 2]]
    assert net.predict_noise(torch.zeros(1, 4, 4, 4), torch.tensor([5]), folded).shape == (
        1,
        4,
        4,
        4,
    )


def test_an_unconditioned_example_ignores_its_source():
    net = small().eval()
    one = batch()
    with torch.no_grad():
        net.model["diffusion_model"].out[2].weight.normal_()
        conditioned = net(**one).predicted_noise
        other = net(**{**one, "source": one["source"].flip(0)}).predicted_noise
        unconditioned = net(**{**one, "has_condition": torch.zeros(2)}).predicted_noise
        unconditioned_other = net(
            **{**one, "has_condition": torch.zeros(2), "source": one["source"].flip(0)}
        ).predicted_noise
    assert not torch.allclose(conditioned, other)
    assert torch.equal(unconditioned, unconditioned_other)


def test_latents_are_scaled_to_unit_standard_deviation():
    net = small().train()
    for _ in range(80):
        net(**batch())
    latents = sample_latents(*net.first_stage_model.encode(batch()["target"]), batch()["noises"][0])
    assert float(net.scale_factor * latents.detach().std()) == pytest.approx(1.0, rel=0.02)


def released(net, changed=None):
    """A checkpoint as the released training writes it: EMA, a second copy of the encoder, a
    loss, a schedule.
    """
    state = dict(net.state_dict())
    for name, tensor in list(state.items()):
        if name.startswith("model."):
            state["model_ema." + name.removeprefix("model.").replace(".", "")] = tensor + (
                changed or 0.0
            )
    state["model_ema.decay"] = torch.tensor(0.9999)
    state["cond_stage_model.features.0.weight"] = state["cond_stage_model.resnet.conv1.weight"]
    state["cond_stage_model.resnet.fc.weight"] = torch.zeros(1000, 8)
    state["first_stage_model.loss.logvar"] = torch.tensor(0.0)
    state["betas"] = torch.linspace(0, 1, 10)
    return {"state_dict": state, "global_step": 7}


def test_a_released_checkpoint_is_read_with_averaged_weights(tmp_path):
    like = {
        "side": 256,
        "channel_multipliers": "1 2 2 4 4",
        "blocks": 2,
        "attention": "1 2 4 8",
        "heads": 8,
        "groups": 32,
        "autoencoder_multipliers": "1 2 4 4",
        "autoencoder_blocks": 2,
    }
    net = small(**like, width=32, autoencoder_width=32, condition_channels=2)
    torch.save(released(net, 0.5), tmp_path / "model.ckpt")
    found = published_weights.read_latent_diffusion(tmp_path / "model.ckpt")
    assert (
        found.config["width"],
        found.config["autoencoder_width"],
        found.config["condition_channels"],
    ) == (32, 32, 2)
    assert found.config["raw_condition"]
    assert not found.trained_with_condition_dropout
    ready = load_network(found)  # every tensor fits
    name = "model.diffusion_model.time_embed.0.bias"
    assert torch.allclose(ready.state_dict()[name], net.state_dict()[name] + 0.5)
    first = "first_stage_model.quant_conv.bias"
    assert torch.equal(ready.state_dict()[first], net.state_dict()[first])


def test_other_files_are_refused(tmp_path):
    torch.save({"state_dict": {"weight": torch.zeros(3)}}, tmp_path / "other.ckpt")
    with pytest.raises(FileProblem, match="latent diffusion"):
        published_weights.read_latent_diffusion(tmp_path / "other.ckpt")


@pytest.mark.slow
def test_the_published_configuration_can_be_trained():
    torch.manual_seed(0)
    net = build_network("latent", {"side": 128}).train()
    one = {name: tensor[:1] for name, tensor in batch(2, 128).items() if name != "noises"}
    one["noises"] = batch(1, 128)["noises"]
    one["time"] = torch.tensor([500])
    optimiser = torch.optim.SGD(net.parameters(), 1e-3)
    losses = []
    for _ in range(3):
        found = net(**one)
        loss = (found.predicted_noise - found.true_noise).abs().mean() + (
            found.reconstruction - one["target"]
        ).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert np.isfinite(losses).all()
    assert losses[-1] < losses[0]
