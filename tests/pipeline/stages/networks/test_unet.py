"""The lab's U-Nets: published tensors, and depth and contact as published, computed here from
their description.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn import functional

from pipeline.core.errors import FileProblem
from pipeline.core.graph import Fallback
from pipeline.core.params import NoParams
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth import photometric, unet
from pipeline.stages.depth.stage import UNET
from pipeline.stages.networks import published_weights, weights_registry
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.unet import UNet
from pipeline.stages.networks.weights import NoWeights

GEL = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")


def state(seed=0, **config):
    torch.manual_seed(seed)
    net = UNet(width=4, **config)
    for norm in (part for part in net.modules() if isinstance(part, torch.nn.BatchNorm2d)):
        for tensor in (norm.weight.data, norm.running_var):
            tensor.uniform_(0.5, 1.5)
        for tensor in (norm.bias.data, norm.running_mean):
            tensor.uniform_(-0.2, 0.2)
    return net.state_dict()


def milesial(tensors):
    """The names of Pytorch-UNet, and what its training adds."""
    renamed = {}
    for name, tensor in tensors.items():
        part, _, rest = name.partition(".")
        if part in ("up", "down"):
            number, _, rest = rest.partition(".")
            part += str(int(number) + 1)
        renamed[f"{part}.{rest}"] = tensor
    return {**renamed, "mask_values": [0, 255]}


def double(tensors, name, field):
    for first in (0, 3):
        at = f"{name}.double_conv"
        field = functional.conv2d(field, tensors[f"{at}.{first}.weight"], padding=1)
        norm = [
            tensors[f"{at}.{first + 1}.{part}"]
            for part in ("running_mean", "running_var", "weight", "bias")
        ]
        mean, variance, gain, offset = (values[:, None, None] for values in norm)
        field = ((field - mean) / torch.sqrt(variance + 1e-5) * gain + offset).clamp(min=0)
    return field


def run(tensors, field):
    """A U-Net of five levels by its definition: crops and pads nothing but what an odd size
    halves away.
    """
    fields = [double(tensors, "inc", field)]
    for k in range(4):
        fields.append(
            double(tensors, f"down.{k}.maxpool_conv.1", functional.max_pool2d(fields[-1], 2))
        )
    field = fields[4]
    for k in range(4):
        skip = fields[3 - k]
        field = functional.conv_transpose2d(
            field, tensors[f"up.{k}.up.weight"], tensors[f"up.{k}.up.bias"], stride=2
        )
        padded = torch.zeros((*field.shape[:2], *skip.shape[2:]))
        top, left = (
            (large - small) // 2
            for large, small in zip(skip.shape[2:], field.shape[2:], strict=True)
        )
        padded[:, :, top : top + field.shape[2], left : left + field.shape[3]] = field
        field = double(tensors, f"up.{k}.conv", torch.cat((skip, padded), 1))
    return functional.conv2d(field, tensors["outc.conv.weight"], tensors["outc.conv.bias"])


def area(n, size):
    """(size, n): weights of the mean over the area of each new pixel, from floor to ceiling of
    its ends.
    """
    weights = torch.zeros(size, n)
    for k in range(size):
        first = k * n // size
        last = -(-(k + 1) * n // size)
        weights[k, first:last] = 1.0 / (last - first)
    return weights


def resized(field, rows, cols):
    return area(field.shape[-2], rows) @ field @ area(field.shape[-1], cols).T


def published_depth(tensors, image, reference, least=-1.9180814027786255, scale=0.9):
    """Difference to 0..255, area means to 160 x 213, shares of brightness, network, mm, area
    means to the image.
    """
    images = (
        torch.from_numpy(a.astype(np.float32)).permute(2, 0, 1)[None] for a in (image, reference)
    )
    image, reference = images
    output = run(tensors, resized((image - reference + 255) / 2, 160, 213) / 255)
    return resized(output * (0.0 - least) / -scale + least, *image.shape[2:])[0, 0].numpy()


@pytest.fixture(scope="module")
def touch():
    rest = optics.render_reference(GEL)
    rows, cols = np.mgrid[: rest.shape[0], : rest.shape[1]]
    pressed = np.clip(1.0 - ((rows - 150) ** 2 + (cols - 200) ** 2) / 50**2, 0, None).astype(
        np.float32
    )
    return TactileFrame(
        sensor="gelslim", image=optics.render(GEL, pressed, seed=None), reference=rest
    )


def test_the_published_configuration_has_the_published_tensors():
    with torch.device("meta"):
        net = UNet()
    assert len(net.state_dict()) == 118
    assert round(sum(p.numel() for p in net.parameters()) / 1e6, 2) == 31.04
    assert net.state_dict()["down.3.maxpool_conv.1.double_conv.0.weight"].shape == (1024, 512, 3, 3)
    assert net.state_dict()["up.0.up.weight"].shape == (1024, 512, 2, 2)
    assert net.state_dict()["up.0.conv.double_conv.0.weight"].shape == (512, 1024, 3, 3)


def test_depth_is_that_of_gelslim_depth(tmp_path, touch):
    tensors = state()
    torch.save(tensors, tmp_path / "unet_bigdata.pth")
    weights = unet.select_weights(GEL, BUBBLE, tmp_path / "unet_bigdata.pth")
    found = UNET.run(touch, GEL, None, weights, NoParams(), SILENT)
    expected = published_depth(tensors, touch.image, touch.reference)
    assert np.ptp(expected) > 0.01
    np.testing.assert_allclose(-found.indentation_mm, expected, atol=1e-4)
    np.testing.assert_allclose(found.depth_mm + found.indentation_mm, GEL.rest_depth_mm, atol=1e-4)
    assert np.array_equal(found.contact, found.indentation_mm > GEL.limits.contact_min_mm)


def test_a_description_beside_the_file_replaces_the_normalisation(tmp_path, touch):
    tensors = state()
    path = tmp_path / "unet_new.pth"
    description = tmp_path / "unet_new.toml"
    torch.save(tensors, path)
    assert "rows" not in weights_registry.load_file(path, published_weights.read_unet).config
    description.write_text("min_depth_mm = -3\nnorm_scale = 0.5\n")
    network = load_network(weights_registry.load_file(path, published_weights.read_unet))
    found = unet.predict_indentation_mm(network, touch.image, touch.reference)
    np.testing.assert_allclose(
        -found, published_depth(tensors, touch.image, touch.reference, -3.0, 0.5), atol=1e-4
    )
    for text, problem in (
        ("max_mm = 1.0", "'max_mm'"),
        ("rows = 1.5", "rows in the"),
        ("rows =", "not valid TOML"),
    ):
        description.write_text(text)
        assert problem in weights_registry.load_file(path, published_weights.read_unet).why


def test_contact_of_a_bubble_is_the_published_mask(tmp_path):
    tensors = state(inputs=1, outputs=2)
    torch.save(milesial(tensors), tmp_path / "masking_unet.pth")
    rest = BUBBLE.rest_depth_mm.astype(np.float32)
    rows, cols = np.mgrid[: rest.shape[0], : rest.shape[1]]
    moved = np.clip(9.0 - 0.1 * np.hypot(rows - 80, cols - 90) - 1.0, -1.0, None).astype(np.float32)
    frame = TactileFrame(sensor="soft_bubble", image=rest - moved, reference=rest)
    shares = ((rest - frame.image) / 1000 + 0.0116) / 0.0341  # in metres
    shown = np.floor(255 * shares).astype(np.float32) / 255
    output = run(tensors, torch.from_numpy(shown)[None, None])[0]
    # half of it touches
    tensors["outc.conv.bias"] -= torch.tensor([0.0, float((output[1] - output[0]).median())])
    torch.save(milesial(tensors), tmp_path / "masking_unet.pth")
    scores = run(tensors, torch.from_numpy(shown)[None, None])[0]
    expected = (scores[1] > scores[0]).numpy()
    clear = (scores[1] - scores[0]).abs().numpy() > 1e-4
    found = UNET.run(
        frame,
        BUBBLE,
        None,
        unet.select_weights(BUBBLE, GEL, tmp_path / "masking_unet.pth"),
        NoParams(),
        SILENT,
    )
    physical = photometric.estimate_depth(frame, BUBBLE, None, photometric.DepthParams())
    known = np.isfinite(physical.depth_mm)
    assert 0.1 < expected[known].mean() < 0.9
    assert np.array_equal(found.contact[clear & known], expected[clear & known])
    np.testing.assert_array_equal(found.indentation_mm, physical.indentation_mm)


@pytest.mark.parametrize(
    ("tensors", "sensor", "problem"),
    [
        (lambda: state(inputs=1, outputs=2), GEL, "contact of a bubble, not of a gel"),
        (state, BUBBLE, "depth of a gel, not of a bubble"),
        (lambda: state(inputs=6, outputs=2), GEL, "6 inputs and 2 outputs"),
        (
            lambda: {n: t for n, t in state().items() if not n.startswith("outc")},
            GEL,
            r"outc.conv.weight missing",
        ),
        (
            lambda: {n: t for n, t in state().items() if ".up." not in n},
            GEL,
            "transposed convolutions",
        ),
        (lambda: {n: t for n, t in state().items() if "down.2" not in n}, GEL, "do not fit"),
        (lambda: {**state(), "outc.conv.bias": torch.tensor([np.nan])}, GEL, "NaN"),
        (lambda: {"w": torch.ones(2)}, GEL, "not weights of a U-Net"),
    ],
)
def test_other_weights_fall_back_to_physics_with_the_reason(
    tmp_path, touch, tensors, sensor, problem
):
    torch.save(tensors(), tmp_path / "w.pth")
    weights = unet.select_weights(sensor, sensor, tmp_path / "w.pth")
    if isinstance(weights, NoWeights):
        assert problem in weights.why
        return
    found = UNET.run(touch, GEL, None, weights, NoParams(), SILENT)
    assert isinstance(found, Fallback)
    assert problem in found.reason


def test_a_method_for_other_weights_names_those_for_pytorch_files(tmp_path):
    torch.save(state(), tmp_path / "unet_bigdata.pth")
    with pytest.raises(FileProblem, match="depth=unet"):
        weights_registry.load_weights(tmp_path / "unet_bigdata.pth")
