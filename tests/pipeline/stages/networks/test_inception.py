"""Inception v3 under torchvision's names: the branches of its blocks, the file, and its features of
a touch.
"""

import numpy as np
import pytest
import torch
from torch.nn import functional

from pipeline.core.errors import FileProblem
from pipeline.lab.evaluation.touch_scoring import encode_change, load_encoder_weights
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.inception import _run_block, compute_features, read_inception
from pipeline.stages.networks.weights import NoWeights

WIDTH = 3  # of every layer; the published ones have 32 to 448
A = {"1x1": 1, "5x5_1": 1, "5x5_2": 5, "3x3dbl_1": 1, "3x3dbl_2": 3, "3x3dbl_3": 3, "_pool": 1}
B = {"3x3": 3, "3x3dbl_1": 1, "3x3dbl_2": 3, "3x3dbl_3": 3}
C = {
    "1x1": 1,
    **{f"7x7_{k + 1}": size for k, size in enumerate((1, (1, 7), (7, 1)))},
    **{f"7x7dbl_{k + 1}": size for k, size in enumerate((1, (7, 1), (1, 7), (7, 1), (1, 7)))},
    "_pool": 1,
}
D = {
    "3x3_1": 1,
    "3x3_2": 3,
    **{f"7x7x3_{k + 1}": size for k, size in enumerate((1, (1, 7), (7, 1), 3))},
}
E = {
    "1x1": 1,
    **{"3x3_1": 1, "3x3_2a": (1, 3), "3x3_2b": (3, 1)},
    **{"3x3dbl_1": 1, "3x3dbl_2": 3, "3x3dbl_3a": (1, 3), "3x3dbl_3b": (3, 1)},
    "_pool": 1,
}
BLOCKS = dict(zip(("5b", "5c", "5d", "6a"), (A, A, A, B), strict=True))
BLOCKS |= {f"6{letter}": C for letter in "bcde"} | {"7a": D, "7b": E, "7c": E}
STEM = {"1a_3x3": 3, "2a_3x3": 3, "2b_3x3": 3, "3b_1x1": 1, "4a_3x3": 3}


@pytest.fixture(scope="module")
def state():
    """Random weights in torchvision's layout, with the parts that features do not need."""
    rng = torch.Generator().manual_seed(0)
    made = {"fc.weight": torch.zeros(4, WIDTH), "AuxLogits.conv0.conv.weight": torch.zeros(1)}

    def add(name, inputs, size):
        kernel = (size, size) if isinstance(size, int) else size
        made[f"{name}.conv.weight"] = torch.randn((WIDTH, inputs, *kernel), generator=rng)
        for part, low in (("weight", 0.5), ("bias", 0.0), ("running_mean", 0), ("running_var", 1)):
            made[f"{name}.bn.{part}"] = low + torch.rand(WIDTH, generator=rng)

    for k, (name, size) in enumerate(STEM.items()):
        add(f"Conv2d_{name}", WIDTH if k else 3, size)
    channels = WIDTH
    for block, layers in BLOCKS.items():
        for layer, size in layers.items():
            first = layer == "_pool" or layer.endswith("_1") or "_" not in layer
            add(f"Mixed_{block}.branch{layer}", channels if first else WIDTH, size)
        ends = {f.partition("_")[0] for f in layers}
        twofold = 2 * sum(layer.endswith("b") and "_" in layer for layer in layers)
        channels = WIDTH * (len(ends) + twofold // 2) + (channels if block in ("6a", "7a") else 0)
    made["channels"] = torch.tensor([channels])
    return made


@pytest.fixture(scope="module")
def file(state, tmp_path_factory):
    path = tmp_path_factory.mktemp("inception") / "inception_v3.pth"
    torch.save({name: tensor for name, tensor in state.items() if name != "channels"}, path)
    return path


def reference(state, name, x, *, stride=1, padding=(0, 0)):
    part = {key: state[f"{name}.bn.{key}"] for key in ("running_mean", "running_var")}
    x = functional.conv2d(x, state[f"{name}.conv.weight"], stride=stride, padding=padding)
    shift, scale = state[f"{name}.bn.bias"], state[f"{name}.bn.weight"]
    mean, deviation = part["running_mean"], (part["running_var"] + 1e-3).sqrt()
    by_channel = (slice(None), None, None)
    x = (x - mean[by_channel]) / deviation[by_channel] * scale[by_channel] + shift[by_channel]
    return x.clamp(min=0.0)


def test_blocks_join_their_branches_as_defined(state):
    rng = torch.Generator().manual_seed(1)
    for block in ("5c", "7a", "7b"):
        first = next(name for name in state if name.startswith(f"Mixed_{block}."))
        x = torch.randn((2, state[first].shape[1], 9, 9), generator=rng)

        def run(layer, given, block=block, **more):
            return reference(state, f"Mixed_{block}.branch{layer}", given, **more)

        pooled = functional.avg_pool2d(x, 3, 1, 1)
        if block == "5c":
            wide = run("5x5_2", run("5x5_1", x), padding=2)
            double = run("3x3dbl_2", run("3x3dbl_1", x), padding=1)
            double = run("3x3dbl_3", double, padding=1)
            parts = [run("1x1", x), wide, double, run("_pool", pooled)]
        elif block == "7a":
            small = run("3x3_2", run("3x3_1", x), stride=2)
            large = run("7x7x3_2", run("7x7x3_1", x), padding=(0, 3))
            large = run("7x7x3_4", run("7x7x3_3", large, padding=(3, 0)), stride=2)
            parts = [small, large, functional.max_pool2d(x, 3, 2)]
        else:
            one = run("3x3_1", x)
            two = run("3x3dbl_2", run("3x3dbl_1", x), padding=1)
            parts = [
                run("1x1", x),
                *(run(f"3x3_2{k}", one, padding=p) for k, p in (("a", (0, 1)), ("b", (1, 0)))),
                *(run(f"3x3dbl_3{k}", two, padding=p) for k, p in (("a", (0, 1)), ("b", (1, 0)))),
                run("_pool", pooled),
            ]
        found = _run_block(state, f"Mixed_{block}.", x, halves=block == "7a")
        assert torch.allclose(found, torch.cat(parts, dim=1), rtol=1e-4, atol=1e-4)


def test_features_depend_on_the_file_alone_and_not_on_its_order(state, file, tmp_path):
    other = tmp_path / "other.pth"
    torch.save(dict(reversed(torch.load(file).items())), other)
    images = torch.rand((2, 3, 299, 299), generator=torch.Generator().manual_seed(2))
    found, again = (compute_features(read_inception(path), images) for path in (file, other))
    assert found.shape == (2, int(state["channels"]))
    assert torch.equal(found, again)
    assert not torch.allclose(found[0], found[1])


@pytest.mark.parametrize("sensor", ["gelslim", "soft_bubble"])
def test_a_touch_has_features(file, sensor):
    spec = load_sensor(sensor)
    channels = 1 if spec.sensor_kind.is_depth else 3
    change = np.zeros((*spec.camera.shape, channels), np.float32)
    still = encode_change(spec, change, {"inception": file})
    change[20:60, 30:70] = 8.0 if spec.sensor_kind.is_depth else 0.5
    touched = encode_change(spec, change, {"inception": file})
    assert np.isfinite(touched).all()
    assert not np.array_equal(still, touched)


def test_a_file_that_lacks_a_tensor_is_named(file, tmp_path):
    lacking = torch.load(file)
    del lacking["Mixed_6b.branch7x7_2.bn.bias"]
    torch.save(lacking, tmp_path / "lacking.pth")
    with pytest.raises(FileProblem, match="not weights of Inception v3"):
        read_inception(tmp_path / "lacking.pth")


def test_another_file_is_named(tmp_path):
    path = tmp_path / "other.pth"
    torch.save({"Conv2d_1a_3x3.conv.weight": torch.zeros(1)}, path)
    with pytest.raises(FileProblem, match=r"not weights of Inception v3.*1 of its 94 convolutions"):
        read_inception(path)
    found = load_encoder_weights(load_sensor("gelslim"), {"inception": path})
    assert isinstance(found, NoWeights)
    assert "torchvision's names" in found.why
