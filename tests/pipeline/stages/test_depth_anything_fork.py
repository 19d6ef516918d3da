"""Checkpoints of MMintLab/depth_anything_v2: distance from the camera, from the depth of both
fingers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional

from pipeline.core.progress import SILENT
from pipeline.io import open_recording
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.depth_anything import DepthAnythingParams, estimate_depth
from pipeline.stages.depth.stage import DEPTH_ANYTHING
from pipeline.stages.networks import published_weights, weights_registry
from pipeline.stages.networks.depth_anything import DepthAnything
from pipeline.stages.networks.network_factory import load_network
from pipeline.stages.networks.weights import NoWeights
from tests.pipeline.io.test_tensors import bubble, saved

BUBBLE = load_sensor("soft_bubble")
SIDE = 56


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(3)
    made = DepthAnything(encoder="vits", contact=False).eval()
    made.depth_head.scratch.output_conv2[2].bias.data.fill_(0.6)  # about 77 of 120 mm
    return made.requires_grad_(False)


def checkpoint(net, path, **others):
    """As `train_single.py` saves it on several GPUs."""
    state = {f"module.{name}": tensor for name, tensor in {**net.state_dict(), **others}.items()}
    optimiser = torch.optim.AdamW([torch.nn.Parameter(torch.zeros(2))]).state_dict()
    torch.save({"model": state, "optimizer": optimiser, "epoch": 39}, path)
    return path


@pytest.fixture(scope="module")
def grasp():
    """A touch2touch grasp whose fingers are pressed by different amounts."""
    rows, cols = torch.meshgrid(torch.arange(140.0), torch.arange(175.0), indexing="ij")
    imprint = torch.stack(
        [0.001 * deep * torch.exp(-((rows - 70) ** 2 + (cols - 90) ** 2) / 800) for deep in (4, 9)]
    )
    return {**bubble(), "bubble_imprint": imprint[:, None]}


def published_distance_m(net, grasp, largest_m, finger):
    """Depth of both fingers from 0 to 1, cubic to 56 px in multiples of 14, sigmoid times the
    largest, bilinear.
    """
    shown = grasp["bubble_depth_ref"] - grasp["bubble_imprint"]
    shown = (shown - shown.min()) / (shown.max() - shown.min())
    small = functional.interpolate(shown[finger][None], (SIDE, 70), mode="bicubic").expand(
        -1, 3, -1, -1
    )
    with torch.inference_mode():
        raw = net(small, None, "relative")[0], net(small, None, "metric")[0]
    assert (raw[0] > 0).all()
    assert torch.allclose(torch.sigmoid(raw[0]), raw[1], atol=1e-6)
    return functional.interpolate(
        largest_m * raw[1][:, None], (140, 175), mode="bilinear", align_corners=True
    )[0, 0]


@pytest.mark.parametrize("finger", [0, 1])
def test_the_indentation_is_the_rest_minus_the_published_distance(net, grasp, tmp_path, finger):
    path = checkpoint(net, tmp_path / "latest.pth")
    (tmp_path / "latest.toml").write_text(f"largest_mm = 120\nside = {SIDE}\n")
    weights = weights_registry.load_file(path, published_weights.read_depth_anything)
    assert (weights.config["answer"], weights.config["contact"]) == ("distance", False)
    frame = open_recording(saved(tmp_path / "data_0.pt", grasp)).streams[finger].frame(0)
    found = DEPTH_ANYTHING.run(frame, BUBBLE, None, weights, DepthAnythingParams(), SILENT)
    distance_mm = 1000 * published_distance_m(net, grasp, 0.12, finger).numpy()
    rest_mm = 80.0
    indentation = rest_mm - distance_mm
    assert 0.5 < indentation.min() < indentation.max() < BUBBLE.limits.indentation_max_mm
    # the rest surface is smoothed
    np.testing.assert_allclose(found.indentation_mm, indentation, atol=0.02)
    np.testing.assert_allclose(found.depth_mm, distance_mm, atol=0.02)
    assert not any("assumed" in note for note in found.notes)


class Says:
    """A network of distances that answers with one share."""

    answer = "distance"
    largest_mm = 0.0
    side = SIDE
    image_content = "frame"

    def __init__(self, share):
        self.share = share

    def __call__(self, image, _window, _kind):
        return torch.full((1, *image.shape[-2:]), self.share), None


@pytest.mark.parametrize(
    ("share", "params", "deep_mm", "word"),
    [
        (0.6, {}, 80 - 72.0, "120 mm is assumed"),
        (0.4, {"largest_mm": 190.0}, 80 - 76.0, ""),
        (1e-9, {}, 0.0, "nothing is touched"),
        (0.9, {}, 0.0, "nothing is touched"),
    ],
)
def test_a_distance_beyond_the_membranes_reach_is_no_touch(
    grasp, tmp_path, share, params, deep_mm, word
):
    frame = open_recording(saved(tmp_path / "data_0.pt", grasp)).streams[0].frame(0)
    found = estimate_depth(frame, BUBBLE, None, Says(share), DepthAnythingParams(**params), SILENT)
    np.testing.assert_allclose(found.indentation_mm, deep_mm, atol=0.05)
    assert found.contact.all() == (deep_mm > 0)
    assert any(word in note for note in found.notes)
    assert any("assumed" in note for note in found.notes) == (not params)


def test_the_range_of_a_grasp_is_that_of_both_fingers(grasp, tmp_path):
    frames = [
        stream.frame(0) for stream in open_recording(saved(tmp_path / "data_0.pt", grasp)).streams
    ]
    assert frames[0].grasp_range == frames[1].grasp_range == pytest.approx((71.0, 80.0), abs=1e-3)
    assert frames[0].image.min() > 75.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", {"answer": "distance", "image_content": "frame", "contact": True}),
        (
            'answer = "metric"\nimage_content = "difference"\ncontact = false',
            {"answer": "metric", "contact": False},
        ),
    ],
)
def test_a_description_says_what_a_checkpoint_predicts(tmp_path, text, expected):
    torch.manual_seed(0)
    path = checkpoint(DepthAnything(encoder="vits"), tmp_path / "latest.pth")
    if text:
        (tmp_path / "latest.toml").write_text(text)
    weights = published_weights.read_depth_anything(path)
    assert expected.items() <= dict(weights.config).items()
    assert (load_network(weights).mask_head is not None) == expected["contact"]


def test_a_contact_head_that_does_not_fit_its_network_is_left_out(net, tmp_path):
    """The fork gives every encoder the head of the small one, which a larger one cannot run."""
    head = {
        "mask_head.mask_head.0.weight": torch.zeros(32, 63, 3, 3),
        "mask_head.mask_head.0.bias": torch.zeros(32),
    }
    weights = published_weights.read_depth_anything(
        checkpoint(net, tmp_path / "latest.pth", **head)
    )
    assert weights.config["contact"] is False
    assert load_network(weights).mask_head is None


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("max_depth = 0.12", "'max_depth'"),
        ('largest_mm = "far"', "largest_mm in the"),
        ('answer = "near"', "'near'"),
    ],
)
def test_a_wrong_description_is_reported(net, grasp, tmp_path: Path, text, problem):
    path = checkpoint(net, tmp_path / "latest.pth")
    (tmp_path / "latest.toml").write_text(text)
    weights = weights_registry.load_file(path, published_weights.read_depth_anything)
    if isinstance(weights, NoWeights):
        assert problem in weights.why
        return
    frame = open_recording(saved(tmp_path / "data_0.pt", grasp)).streams[0].frame(0)
    assert (
        problem
        in DEPTH_ANYTHING.run(frame, BUBBLE, None, weights, DepthAnythingParams(), SILENT).reason
    )
