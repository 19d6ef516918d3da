"""touch2touch's `checkpoint.ckpt`, plain and as pytorch-lightning 1.4 saves it: read, and
computed as defined.
"""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
import torch

from pipeline.core.errors import FileProblem, ModelMissing
from pipeline.core.progress import reading_reported_to
from pipeline.stages.networks import published_weights
from pipeline.stages.networks.latent_diffusion import LatentDiffusion
from pipeline.stages.networks.network_factory import load_network
from tests.pipeline.stages.networks import published_latent as published

SMALL = {"width": 32, "autoencoder_width": 32, "condition_channels": 4}
TOLERANCE = 1e-4
COPY = {"conv1": "0", "bn1": "1", "layer1": "4", "layer2": "5", "layer3": "6", "layer4": "7"}


def released_state():
    """Every tensor that the lab's training holds.

    The average of the denoiser is another network.
    """
    torch.manual_seed(0)
    net = LatentDiffusion(**SMALL)
    for name, tensor in net.state_dict().items():
        if name.endswith("running_var"):
            tensor.uniform_(0.5, 1.5)
        elif tensor.is_floating_point() and (not tensor.any() or name.endswith(("bias", "mean"))):
            tensor.normal_(0, 0.03)  # layers that begin at zero would hide a mistake
    net.scale_factor.fill_(0.18)
    state = dict(net.state_dict())
    for name, tensor in net.state_dict().items():
        if name.startswith("model."):
            state["model_ema." + name.removeprefix("model.").replace(".", "")] = (
                tensor + 0.01 * torch.randn_like(tensor)
            )
        if name.startswith("cond_stage_model.resnet."):
            part, _, rest = name.removeprefix("cond_stage_model.resnet.").partition(".")
            state[f"cond_stage_model.features.{COPY[part]}.{rest}"] = tensor
    state["cond_stage_model.resnet.fc.weight"] = torch.zeros(1000, 32)
    state |= {"model_ema.decay": torch.tensor(0.9999), "model_ema.num_updates": torch.tensor(7)}
    return state | {"betas": torch.zeros(1000), "alphas_cumprod": torch.zeros(1000)}


@pytest.fixture(scope="module")
def state():
    return released_state()


@pytest.fixture
def lightning(monkeypatch):
    """What pytorch-lightning 1.4 adds to a checkpoint.

    Its classes exist while the file is written only.
    """
    names = (
        "pytorch_lightning",
        "pytorch_lightning.callbacks",
        "pytorch_lightning.callbacks.model_checkpoint",
    )
    for name in names:
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    module = sys.modules[names[-1]]
    module.ModelCheckpoint = type("ModelCheckpoint", (), {"__module__": names[-1]})
    module.AttributeDict = type("AttributeDict", (dict,), {"__module__": names[-1]})
    return {
        "epoch": 29,
        "global_step": 12345,
        "pytorch-lightning_version": "1.4.2",
        "callbacks": {
            module.ModelCheckpoint: {"monitor": "val/loss", "best_model_score": torch.tensor(0.1)}
        },
        "optimizer_states": [
            {"state": {0: {"step": 3, "exp_avg": torch.full((9,), torch.nan)}}, "param_groups": []}
        ],
        "lr_schedulers": [{"last_epoch": 3, "lr_lambdas": [None]}],
        "loops": {"fit_loop": module.ModelCheckpoint()},
        "hparams_name": "kwargs",
        "hyper_parameters": module.AttributeDict(lr=1e-6, of=module.ModelCheckpoint()),
    }


class Said(list):
    def step(self, fraction, text):
        self.append((fraction, text))


@pytest.mark.parametrize("by_lightning", [False, True])
def test_a_checkpoint_computes_what_its_definition_says(
    state, lightning, tmp_path, monkeypatch, by_lightning
):
    path = tmp_path / "checkpoint.ckpt"
    torch.save({"state_dict": state, **(lightning if by_lightning else {"global_step": 7})}, path)
    for name in [name for name in sys.modules if name.startswith("pytorch_lightning")]:
        monkeypatch.delitem(sys.modules, name)
    said = Said()
    with reading_reported_to(said):
        weights = published_weights.read_latent_diffusion(path)
    assert not weights.trained_with_condition_dropout
    assert weights.config["leading_times"]
    assert said[-1] == (1.0, "reading checkpoint.ckpt")
    assert [fraction for fraction, _ in said] == sorted(fraction for fraction, _ in said)
    # not both denoisers
    assert sum(t.nbytes for t in weights.tensors.values()) < 0.66 * path.stat().st_size
    ready = load_network(weights)
    first, second = (
        published.Published(state, f"{part}_stage_model.") for part in ("first", "cond")
    )
    averaged = {
        name: state[
            "model_ema.diffusion_model"
            + name.removeprefix("model.diffusion_model.").replace(".", "")
        ]
        for name in state
        if name.startswith("model.diffusion_model.")
    }
    torch.manual_seed(1)
    image = torch.tanh(torch.randn(2, 3, 64, 64))
    source = torch.randn(2, 3, 128, 128)
    noisy = torch.randn(2, 4, 16, 16)
    time = torch.tensor([3, 981])
    with torch.inference_mode():
        expected = {
            "encoder": published.encode(first, image),
            "decoder": published.decode(first, noisy / 0.18),
            "condition": published.encode_condition(second, source),
        }
        expected["noise"] = published.predict_noise(
            published.Published(averaged, "model.diffusion_model."),
            noisy,
            time,
            expected["condition"],
        )
        found = {
            "encoder": ready.first_stage_model.encode(image)[0],
            "decoder": ready.decode_images(noisy),
            "condition": ready.cond_stage_model(source),
            "noise": ready.predict_noise(noisy, time, expected["condition"]),
        }
    for part, tensor in expected.items():
        assert tensor.std() > 0.01, part
        np.testing.assert_allclose(found[part], tensor, atol=TOLERANCE, err_msg=part)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (
            lambda state: {n: t for n, t in state.items() if not n.startswith("first_stage")},
            "conv_in.weight missing",
        ),
        (lambda state: {"cond_stage_model": state["betas"]}, "not latent diffusion weights"),
        (
            lambda state: {
                **state,
                "first_stage_model.quant_conv.bias": torch.full((8,), torch.inf),
            },
            "NaN or infinity",
        ),
    ],
)
def test_another_table_is_refused_in_a_sentence(state, tmp_path, change, problem):
    torch.save({"state_dict": change(state)}, tmp_path / "checkpoint.ckpt")
    with pytest.raises(FileProblem, match=problem):
        published_weights.read_latent_diffusion(tmp_path / "checkpoint.ckpt")


def test_a_missing_tensor_is_named(state, tmp_path):
    less = {
        n: t for n, t in state.items() if n != "first_stage_model.decoder.up.1.block.0.conv1.weight"
    }
    torch.save({"state_dict": less}, tmp_path / "checkpoint.ckpt")
    with pytest.raises(
        ModelMissing, match=r"1 tensors are missing.*decoder\.up\.1\.block\.0\.conv1\.weight"
    ):
        load_network(published_weights.read_latent_diffusion(tmp_path / "checkpoint.ckpt"))
