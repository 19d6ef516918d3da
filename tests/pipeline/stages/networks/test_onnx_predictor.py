"""Networks run by OpenCV from their ONNX export answer as by torch, and load no torch."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.core.errors import ModelMissing
from pipeline.stages.depth.bubble_network_output import N_OUTPUTS, decode_prediction, decode_tensors
from pipeline.stages.networks import network_factory, weights_registry
from pipeline.stages.networks.network_factory import (
    ONNX_KINDS,
    build_network,
    load_network,
    load_predictor,
)
from pipeline.stages.networks.onnx_predictor import OnnxPredictor
from pipeline.stages.networks.weights import (
    Weights,
    load_weights,
    load_weights_of_package,
    save_weights,
)

MAX_RELATIVE_ERROR = 1e-4  # of OpenCV against torch, over the largest value
CONFIG = {"inputs": 2, "outputs": 3, "base_channels": 8, "levels": 3, "max_channels": 12}


def make_weights(config=CONFIG):
    """Weights of a small U-Net with something in every tensor."""
    torch.manual_seed(1)
    net = build_network("compact_unet", config)
    for name, tensor in net.state_dict().items():
        if tensor.is_floating_point() and not name.endswith(("0.weight", "thin.0.weight")):
            tensor.copy_(torch.rand_like(tensor) + 0.5)
    tensors = {name: t.float().numpy().copy() for name, t in net.state_dict().items()}
    return Weights(name="w", kind="compact_unet", config=config, tensors=tensors)


def make_image(channels, rows, cols):
    """Noise around a contact in the physical channels of a gel."""
    image = (
        np.random.default_rng(3).normal(scale=0.5, size=(channels, rows, cols)).astype(np.float32)
    )
    if channels > 11:
        y, x = np.mgrid[:rows, :cols].astype(np.float32)
        bump = np.exp(-((x - cols / 2) ** 2 + (y - rows / 2) ** 2) / 300.0)
        image[8] = 0.3 * bump
        image[9] = -0.2 * bump
        image[10] = bump
        image[11] = bump > 0.3
    return image


def assert_same_as_torch(weights, size):
    image = make_image(weights.config["inputs"], *size)
    with torch.inference_mode():
        expected = load_network(weights)(torch.from_numpy(image)[None])
    expected = expected if isinstance(expected, tuple) else (expected,)
    outputs = load_predictor(weights)(image)
    assert len(outputs) == len(expected)
    for output, tensor in zip(outputs, expected, strict=True):
        want = tensor[0].numpy()
        assert output.dtype == np.float32
        assert output.shape == want.shape
        assert np.abs(output - want).max() < MAX_RELATIVE_ERROR * max(
            1.0, float(np.abs(want).max())
        )


@pytest.mark.parametrize("fold", [1, 2])
def test_one_export_answers_as_torch_for_images_of_any_size(fold):
    weights = make_weights({**CONFIG, "fold": fold})
    for size in ((32, 40), (31, 37), (18, 22), (32, 40)):
        assert_same_as_torch(weights, size)


@pytest.mark.parametrize(
    ("name", "size"), [("bubble_depth", (171, 224)), ("bubble_depth", (97, 130))]
)
def test_shipped_weights_answer_as_torch(name, size):
    weights = weights_registry.load_shipped(name)
    assert weights.kind in ONNX_KINDS
    assert weights.onnx
    assert_same_as_torch(weights, size)


def test_the_onnx_file_is_kept_with_the_weights_and_changes_no_digest(tmp_path):
    weights = make_weights()
    save_weights(tmp_path / "w.safetensors", replace(weights, onnx=b"graph"))
    loaded = load_weights(tmp_path / "w.safetensors")
    assert loaded.read_onnx() == b"", "only of the package's own files"
    assert load_weights_of_package(tmp_path / "w.safetensors").read_onnx() == b"graph"
    assert loaded.tensors.keys() == weights.tensors.keys()
    assert loaded.content_digest == weights.content_digest


def test_weights_that_do_not_fit_are_refused():
    weights = make_weights()
    without = {name: t for name, t in weights.tensors.items() if name != "thin.1.bias"}
    with pytest.raises(ModelMissing, match=r"1 tensors .* 'thin.1.bias'"):
        load_predictor(replace(weights, tensors=without))
    with pytest.raises(ModelMissing, match="heads"):
        load_predictor(replace(weights, config={**CONFIG, "heads": 3}))


@pytest.mark.parametrize("content", [b"no graph", b"location"])
def test_a_damaged_graph_or_one_that_names_files_is_refused(content):
    with pytest.raises(ModelMissing, match="'w'"):
        network_factory._load_predictor(replace(make_weights(), onnx=content))
    with pytest.raises(ValueError, match="ONNX"):
        OnnxPredictor(content)


@pytest.mark.parametrize("graph", [b"", b"graph", b"\x1b]0;owned\x07"])
def test_a_graph_in_a_strangers_file_is_not_run(tmp_path, graph, monkeypatch):
    """OpenCV would end the process, or never end, with some; the tensors are exported, once."""
    weights = make_weights()
    save_weights(tmp_path / "w.safetensors", replace(weights, onnx=graph))
    image = make_image(CONFIG["inputs"], 32, 40)
    expected = load_predictor(replace(weights, onnx=network_factory.export_weights(weights)))(image)
    network_factory.release_networks()
    given = load_weights(tmp_path / "w.safetensors")
    np.testing.assert_array_equal(load_predictor(given)(image), expected)
    network_factory.release_networks()
    monkeypatch.setattr(network_factory, "export_weights", None)
    np.testing.assert_array_equal(load_predictor(given)(image), expected)


@pytest.mark.parametrize("fold", [0, -1, 10**6, "a"])
def test_an_impossible_fold_is_refused(fold):
    with pytest.raises(ModelMissing, match=r"'w'|compact_unet"):
        load_predictor(replace(make_weights(), config={**CONFIG, "fold": fold}, onnx=b""))
    with pytest.raises(ModelMissing, match="'w'"):
        network_factory._load_predictor(
            replace(make_weights(), config={**CONFIG, "fold": fold}, onnx=b"graph")
        )


def test_bubble_outputs_are_decoded_alike_for_training_and_prediction():
    rng = np.random.default_rng(2)
    output, smooth = (
        rng.normal(scale=20.0, size=(n, 6, 7)).astype(np.float32) for n in (N_OUTPUTS, 1)
    )
    tensors = decode_tensors(torch.from_numpy(output[None]), torch.from_numpy(smooth[None]))
    arrays = decode_prediction(output, smooth[0])
    np.testing.assert_allclose(arrays.displacement_mm, tensors.displacement_mm[0])
    np.testing.assert_allclose(
        arrays.object_displacement_mm, tensors.object_displacement_mm[0], atol=1e-5
    )
    np.testing.assert_allclose(arrays.expected_error_mm, tensors.log_error[0].exp(), rtol=1e-5)
    np.testing.assert_allclose(arrays.contact, tensors.contact[0].sigmoid(), atol=1e-6)


BUBBLE = """
sensor = load_sensor("soft_bubble")
rest = sensor.rest_depth_mm.astype(np.float32)
frame = TactileFrame(sensor=sensor.name, image=rest - 2, reference=rest)
"""


def test_the_network_of_the_depth_stage_loads_no_torch():
    """Torch takes 200 MB and two seconds."""
    code = f"""
import sys
import numpy as np
from pipeline.core.progress import SILENT
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.stage import NETWORK
from pipeline.core.values.frames import TactileFrame
{BUBBLE}
depth = NETWORK.run(frame, sensor, None, NETWORK.weights(sensor, sensor, None), NETWORK.params(), SILENT)
assert depth.expected_error_mm is not None and depth.indentation_mm.max() > 0.3
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
