"""Weights of other packages as trainings save them: wrapped, prefixed, in 16 bits, on a GPU, by
an old torch.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from pipeline.core.errors import FileProblem
from pipeline.stages.networks import published_weights
from pipeline.stages.networks.depth_anything import DepthAnything
from pipeline.stages.networks.network_factory import load_network
from tests.pipeline.stages.networks.test_released_checkpoint import released_state
from tests.pipeline.stages.networks.test_unet import milesial
from tests.pipeline.stages.networks.test_unet import state as unet_state
from tests.pipeline.stages.networks.test_vqvae import small

KINDS = {
    "latent": (released_state, published_weights.read_latent_diffusion),
    "depth_unet": (lambda: unet_state(inputs=3, outputs=1), published_weights.read_unet),
    "contact_unet": (
        lambda: milesial(unet_state(inputs=1, outputs=2)),
        published_weights.read_unet,
    ),
    "depth_anything": (
        lambda: DepthAnything(encoder="vits", side=42).state_dict(),
        published_weights.read_depth_anything,
    ),
    "vqvae": (lambda: small(codes=33).state_dict(), published_weights.read_vqvae),
}
OPTIMISER = {
    "state": {0: {"step": torch.tensor(3.0), "exp_avg": torch.full((9,), torch.nan)}},
    "param_groups": [{}],
}


def prefixed(state, prefix):
    return {prefix + name: tensor for name, tensor in state.items()}


def to(state, number):
    return {
        n: t.to(number) if torch.is_tensor(t) and t.is_floating_point() else t
        for n, t in state.items()
    }


LAYOUTS = {
    "in a checkpoint": lambda state: {
        "epoch": 3,
        "state_dict": state,
        "optimizer_states": [OPTIMISER],
    },
    "under another key": lambda state: {
        "network": state,
        "optim": OPTIMISER,
        "loss": np.float64(0.1),
    },
    "distributed": lambda state: prefixed(state, "module."),
    "distributed checkpoint": lambda state: {
        "model_state_dict": prefixed(state, "module."),
        "optim": OPTIMISER,
    },
    "compiled": lambda state: prefixed(state, "_orig_mod.module."),
    "averaged": lambda state: {"n_averaged": torch.tensor(5), **prefixed(state, "module.")},
    "float16": lambda state: to(state, torch.float16),
    "bfloat16": lambda state: to(state, torch.bfloat16),
    "parameters": lambda state: {
        n: torch.nn.Parameter(t, requires_grad=t.is_floating_point()) if torch.is_tensor(t) else t
        for n, t in state.items()
    },
}
LARGE = ("latent", "depth_anything")  # of these only layouts that differ in what is read


@pytest.fixture(scope="module", params=KINDS)
def kind(request, tmp_path_factory):
    """(state, reader, what the reader makes of the bare state, which its network takes)."""
    make, read = KINDS[request.param]
    path = tmp_path_factory.mktemp("bare") / "weights.pth"
    state = make()
    torch.save(state, path)
    bare = read(path)
    load_network(bare)
    return state, read, bare


def check_equal(weights, bare, atol=0.0):
    assert dict(weights.config) == dict(bare.config)
    assert weights.tensors.keys() == bare.tensors.keys()
    for name, tensor in weights.tensors.items():
        np.testing.assert_allclose(tensor, bare.tensors[name], atol=atol, rtol=atol, err_msg=name)


@pytest.mark.parametrize(
    ("kind", "layout"),
    [
        (kind, layout)
        for kind in KINDS
        for layout in LAYOUTS
        if kind not in LARGE or layout in ("distributed checkpoint", "compiled", "bfloat16")
    ],
    indirect=["kind"],
)
def test_every_layout_gives_the_tensors_of_the_bare_state(kind, tmp_path, layout):
    state, read, bare = kind
    torch.save(LAYOUTS[layout](state), tmp_path / "weights.pth")
    weights = read(tmp_path / "weights.pth")
    check_equal(weights, bare, 0.01 if "float16" in layout else 0.0)
    if "float16" in layout:  # others are equal to what a network takes
        load_network(weights)


def test_tensors_saved_on_a_gpu_are_read_without_one(kind, tmp_path, monkeypatch):
    state, read, bare = kind
    monkeypatch.setattr(torch.serialization, "location_tag", lambda _storage: "cuda:1")
    torch.save(state, tmp_path / "weights.ckpt")
    check_equal(read(tmp_path / "weights.ckpt"), bare)


def test_a_file_of_torch_before_1_6_says_how_it_becomes_readable(kind, tmp_path):
    state, read, bare = kind
    path = tmp_path / "weights.ckpt"
    torch.save(state, path, _use_new_zipfile_serialization=False)
    with pytest.raises(FileProblem, match=r"torch before 1\.6.*save its tensors again"):
        read(path)
    torch.save(torch.load(path, weights_only=True), path)
    check_equal(read(path), bare)


def test_a_file_is_read_by_its_content_whatever_its_name(kind, tmp_path):
    state, read, bare = kind
    torch.save(state, tmp_path / "weights.safetensors")
    tensors = {
        name: tensor.clone().contiguous()
        for name, tensor in state.items()
        if torch.is_tensor(tensor)
    }
    save_file(tensors, tmp_path / "weights.pth")
    for name in ("weights.safetensors", "weights.pth"):
        check_equal(read(tmp_path / name), bare)


def test_a_whole_network_is_refused_with_the_remedy(tmp_path):
    torch.save(small(codes=33), tmp_path / "model.pth")
    with pytest.raises(FileProblem, match="save the network's state_dict"):
        published_weights.read_vqvae(tmp_path / "model.pth")
