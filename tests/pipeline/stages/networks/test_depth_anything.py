"""Depth Anything V2: published tensor names and shapes, files of every kind, and its output."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch.nn import functional

from pipeline.core.errors import FileProblem
from pipeline.stages.networks import published_weights as files
from pipeline.stages.networks.depth_anything import DepthAnything
from pipeline.stages.networks.network_factory import build_network, load_network

# As published: `pretrained` is facebookresearch's DINOv2 (patches of 14, 518 pixels, no registers),
# `depth_head` the DPT head of DepthAnything/Depth-Anything-V2, `mask_head` the paper's contact
# head. {w} is the width of the encoder, {f} the features of the decoder, {a} to {d} its four
# projections.
ENCODER = {
    "cls_token": "1 1 {w}",
    "pos_embed": "1 1370 {w}",
    "mask_token": "1 {w}",
    "patch_embed.proj.weight": "{w} 3 14 14",
    "patch_embed.proj.bias": "{w}",
    "norm.weight": "{w}",
    "norm.bias": "{w}",
}
BLOCK = {
    "norm1.weight": "{w}",
    "norm1.bias": "{w}",
    "attn.qkv.weight": "3*{w} {w}",
    "attn.qkv.bias": "3*{w}",
    "attn.proj.weight": "{w} {w}",
    "attn.proj.bias": "{w}",
    "ls1.gamma": "{w}",
    "norm2.weight": "{w}",
    "norm2.bias": "{w}",
    "mlp.fc1.weight": "4*{w} {w}",
    "mlp.fc1.bias": "4*{w}",
    "mlp.fc2.weight": "{w} 4*{w}",
    "mlp.fc2.bias": "{w}",
    "ls2.gamma": "{w}",
}
HEAD = {
    "projects.0.weight": "{a} {w} 1 1",
    "projects.0.bias": "{a}",
    "projects.1.weight": "{b} {w} 1 1",
    "projects.1.bias": "{b}",
    "projects.2.weight": "{c} {w} 1 1",
    "projects.2.bias": "{c}",
    "projects.3.weight": "{d} {w} 1 1",
    "projects.3.bias": "{d}",
    "resize_layers.0.weight": "{a} {a} 4 4",
    "resize_layers.0.bias": "{a}",
    "resize_layers.1.weight": "{b} {b} 2 2",
    "resize_layers.1.bias": "{b}",
    "resize_layers.3.weight": "{d} {d} 3 3",
    "resize_layers.3.bias": "{d}",
    "scratch.layer1_rn.weight": "{f} {a} 3 3",
    "scratch.layer2_rn.weight": "{f} {b} 3 3",
    "scratch.layer3_rn.weight": "{f} {c} 3 3",
    "scratch.layer4_rn.weight": "{f} {d} 3 3",
    "scratch.output_conv1.weight": "{f}//2 {f} 3 3",
    "scratch.output_conv1.bias": "{f}//2",
    "scratch.output_conv2.0.weight": "32 {f}//2 3 3",
    "scratch.output_conv2.0.bias": "32",
    "scratch.output_conv2.2.weight": "1 32 1 1",
    "scratch.output_conv2.2.bias": "1",
}
FUSION = {"out_conv.weight": "{f} {f} 1 1", "out_conv.bias": "{f}"} | {
    f"resConfUnit{unit}.conv{conv}.{part}": "{f} {f} 3 3" if part == "weight" else "{f}"
    for unit in (1, 2)
    for conv in (1, 2)
    for part in ("weight", "bias")
}
MASK = {
    "mask_head.0.weight": "{f}//2 {f} 3 3",
    "mask_head.0.bias": "{f}//2",
    "mask_head.2.weight": "1 {f}//2 1 1",
    "mask_head.2.bias": "1",
}
PUBLISHED = {
    "vits": {
        "w": 384,
        "blocks": 12,
        "f": 64,
        "a": 48,
        "b": 96,
        "c": 192,
        "d": 384,
        "numbers": 24_785_089,
    },
    "vitb": {
        "w": 768,
        "blocks": 12,
        "f": 128,
        "a": 96,
        "b": 192,
        "c": 384,
        "d": 768,
        "numbers": 97_470_785,
    },
    "vitl": {
        "w": 1024,
        "blocks": 24,
        "f": 256,
        "a": 256,
        "b": 512,
        "c": 1024,
        "d": 1024,
        "numbers": 335_315_649,
    },
}


def table(encoder):
    """Name -> shape of every tensor of a published file with the contact head."""
    of = PUBLISHED[encoder]
    named = {f"pretrained.{name}": shape for name, shape in ENCODER.items()}
    for k in range(of["blocks"]):
        named |= {f"pretrained.blocks.{k}.{name}": shape for name, shape in BLOCK.items()}
    named |= {f"depth_head.{name}": shape for name, shape in HEAD.items()}
    for k in range(1, 5):
        named |= {
            f"depth_head.scratch.refinenet{k}.{name}": shape for name, shape in FUSION.items()
        }
    named |= {f"mask_head.{name}": shape for name, shape in MASK.items()}
    return {
        name: tuple(eval(size) for size in shape.format(**of).split())
        for name, shape in named.items()
    }


@pytest.fixture(scope="module")
def small():
    torch.manual_seed(1)
    net = DepthAnything(encoder="vits", side=42).eval()
    for parameter in net.parameters():  # far enough from its beginning that places and scales count
        parameter.data += 0.02 * torch.randn_like(parameter)
    return net


@pytest.mark.parametrize("encoder", sorted(PUBLISHED))
def test_tensors_have_the_published_names_and_shapes(encoder):
    with torch.device("meta"):
        net = DepthAnything(encoder=encoder)
    own = {name: tuple(tensor.shape) for name, tensor in net.state_dict().items()}
    assert own == table(encoder)
    without = sum(
        t.numel() for name, t in net.state_dict().items() if not name.startswith("mask_head.")
    )
    assert without == PUBLISHED[encoder]["numbers"]


def test_no_contact_head_means_no_tensors_of_it():
    with torch.device("meta"):
        names = DepthAnything(contact=False).state_dict().keys()
    assert set(names) == {name for name in table("vits") if not name.startswith("mask_head.")}


@pytest.mark.parametrize("kind", ["wrapped", "half", "bf16", "safetensors", "bare"])
def test_all_file_kinds_are_read_as_float32(small, tmp_path, kind):
    tensors = small.state_dict()
    path = tmp_path / ("w.safetensors" if kind == "safetensors" else "w.pth")
    if kind == "safetensors":
        save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    elif kind == "wrapped":
        torch.save(
            {"model": {f"module.{name}": t for name, t in tensors.items()}, "epoch": 3}, path
        )
    else:
        like = {"half": torch.float16, "bf16": torch.bfloat16}.get(kind, torch.float32)
        kept = {
            n: t.to(like)
            for n, t in tensors.items()
            if kind != "bare" or not n.startswith("mask_head.")
        }
        torch.save(kept, path)
    weights = files.read_depth_anything(path)
    assert all(tensor.dtype == np.float32 for tensor in weights.tensors.values())
    assert weights.config["encoder"] == "vits"
    assert (weights.config["contact"], weights.config["answer"]) == (
        (False, "relative") if kind == "bare" else (True, "distance")
    )
    ready = load_network(weights)
    assert all(p.dtype == torch.float32 for p in ready.parameters())
    with torch.inference_mode():
        picture = torch.rand(1, 3, 28, 42)
        rough = 0.1 if kind in ("half", "bf16") else 1e-5
        if kind != "bare":
            torch.testing.assert_close(ready(picture)[0], small(picture)[0], rtol=rough, atol=rough)


@pytest.mark.parametrize("fault", ["cut", "other", "list", "wide", "nan", "code", "missing"])
def test_other_files_are_refused(small, tmp_path, fault):
    path = tmp_path / "w.pth"
    tensors = dict(small.state_dict())
    wrong = {
        "cut": ("cut short", tensors),
        "other": ("Depth Anything V2", {"x": torch.ones(3)}),
        "list": ("table", [1, 2]),
        "wide": ("1536", tensors | {"pretrained.cls_token": torch.zeros(1, 1, 1536)}),
        "nan": ("NaN", tensors | {"pretrained.norm.bias": torch.full((384,), torch.nan)}),
        "code": ("table of named tensors", {"x": pytest.approx}),
        "missing": ("No such file", {}),
    }
    torch.save(wrong[fault][1], path)
    if fault == "cut":
        path.write_bytes(path.read_bytes()[:-1000])
    elif fault == "missing":
        path.unlink()
    with pytest.raises(FileProblem, match=wrong[fault][0]):
        files.read_depth_anything(path)


def test_any_image_of_whole_patches_is_accepted(small):
    with torch.inference_mode():
        for rows, cols in ((14, 14), (42, 28), (28, 70)):
            depth, contact = small(torch.rand(2, 3, rows, cols))
            assert depth.shape == contact.shape == (2, rows, cols)
            assert 0 <= float(depth.min()) <= float(depth.max()) <= 1
        relative = small(torch.rand(1, 3, 28, 28), None, "relative")[0]
        assert float(relative.min()) >= 0


def test_a_crop_keeps_its_position_embeddings(small):
    picture = torch.rand(1, 3, 56, 70)
    with torch.inference_mode():
        whole = small(picture)[0]
        torch.testing.assert_close(small(picture, (0, 0, 4, 5))[0], whole)
        part = picture[..., 14:42, 28:70]
        here = small(part, (1, 2, 4, 5))[0]
        there = small(part, (2, 0, 4, 5))[0]
    assert here.shape == (1, 28, 42)
    assert not torch.allclose(here, there)


def test_position_embeddings_of_the_training_size_are_unchanged(small):
    encoder = small.pretrained
    first, places = encoder._position_embeddings(37, 37)
    again = places.permute(0, 2, 3, 1).reshape(1, 37 * 37, -1)
    assert torch.equal(torch.cat((first, again), 1), encoder.pos_embed)
    wide = encoder._position_embeddings(10, 21)[1]
    assert wide.shape[-2:] == (10, 21)
    # what published code does: stretched by a tenth of a patch more than the size needs
    grid = encoder.pos_embed[:, 1:].reshape(1, 37, 37, -1).permute(0, 3, 1, 2)
    torch.testing.assert_close(
        wide, functional.interpolate(grid, scale_factor=(10.1 / 37, 21.1 / 37), mode="bicubic")
    )


def test_attention_is_the_weighted_sum_of_values(small):
    attention = small.pretrained.blocks[0].attn
    tokens = torch.randn(1, 5, 384)
    with torch.inference_mode():
        q, k, v = attention.qkv(tokens).reshape(5, 3, 6, 64).permute(1, 2, 0, 3)
        likeness = torch.softmax(q @ k.transpose(1, 2) / 8.0, dim=-1)
        by_hand = attention.proj((likeness @ v).permute(1, 0, 2).reshape(1, 5, 384))
        torch.testing.assert_close(attention(tokens), by_hand, rtol=1e-4, atol=1e-5)


def test_unknown_configuration_values_are_refused():
    from pipeline.core.errors import ModelMissing

    with pytest.raises(ModelMissing, match="no encoder 'vitg'"):
        build_network("depth_anything", {"encoder": "vitg"})
