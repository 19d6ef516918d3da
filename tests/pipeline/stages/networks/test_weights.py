"""Weights are read back unchanged, 16-bit floats become float32, and every faulty file is
refused in one sentence.
"""

from __future__ import annotations

import os
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save_file

from pipeline.core.digests import compute_digest
from pipeline.core.errors import FileProblem
from pipeline.stages.networks import weights as weights_module
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import (
    NoWeights,
    Weights,
    load_tensors,
    load_weights,
    load_weights_of_package,
    save_weights,
)


def some(scale=1.0, **more):
    rng = np.random.default_rng(2)
    tensors = {
        "a.weight": scale * rng.standard_normal((3, 2)).astype(np.float32),
        "a.bias": np.zeros(2, np.float32),
    }
    header = {
        "kind": "compact_unet",
        "config": {"inputs": 3, "name": "x"},
        "card": {"task": "gel_depth", "seed": "4"},
    }
    return Weights(**{"name": "some", "tensors": tensors, **header, **more})


def test_saved_weights_and_their_card_are_read_back(tmp_path):
    weights = some()
    path = tmp_path / "some.safetensors"
    save_weights(path, weights)
    back = load_weights(path)
    assert (back.kind, dict(back.config), dict(back.card)) == (
        weights.kind,
        weights.config,
        weights.card,
    )
    assert all(np.array_equal(back.tensors[name], t) for name, t in weights.tensors.items())
    assert compute_digest(back) == compute_digest(weights)
    assert "| seed | 4 |\n" in (tmp_path / "some.md").read_text()


def test_a_single_number_keeps_its_shape(tmp_path):
    save_weights(tmp_path / "one.safetensors", some(tensors={"count": np.array(7.0, np.float32)}))
    assert load_weights(tmp_path / "one.safetensors").tensors["count"].shape == ()


def test_both_16_bit_formats_are_read_as_float32(tmp_path):
    save_weights(tmp_path / "half.safetensors", some(), use_float16=True)
    half = load_weights(tmp_path / "half.safetensors")
    assert all(t.dtype == np.float32 for t in half.tensors.values())
    np.testing.assert_allclose(half.tensors["a.weight"], some().tensors["a.weight"], rtol=1e-3)
    torch = pytest.importorskip("torch")
    from safetensors.torch import save_file as save_torch

    save_torch(
        {"x": torch.tensor([1.0, -2.5, 3e38], dtype=torch.bfloat16)}, tmp_path / "b.safetensors"
    )
    x = load_tensors(tmp_path / "b.safetensors")[1]["x"]
    assert x.dtype == np.float32
    np.testing.assert_allclose(x, [1.0, -2.5, 3e38], rtol=4e-3)


def test_the_digest_covers_tensors_and_configuration_only():
    digest = compute_digest(some())
    assert compute_digest(some(card={"seed": "5"})) == digest
    assert compute_digest(some(scale=1.001)) != digest
    assert compute_digest(some(config={"inputs": 4, "name": "x"})) != digest
    with pytest.raises(ValueError, match="read-only"):
        some().tensors["a.bias"][0] = 1.0


@settings(max_examples=40)
@given(data=st.data())
def test_a_truncated_or_damaged_file_is_refused(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("cut") / "w.safetensors"
    save_weights(path, some())
    whole = path.read_bytes()
    length = data.draw(st.integers(0, len(whole) - 1))
    path.write_bytes(whole[:length])
    with pytest.raises(FileProblem, match="truncated"):
        load_weights(path)
    assert isinstance(weights_registry.load_file(path), NoWeights)


def test_missing_foreign_and_non_finite_files_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    with pytest.raises(FileProblem, match=r"cannot read the weights \(No such file"):
        load_weights(path)
    save_file({"x": np.ones(3, np.float32)}, path)
    with pytest.raises(FileProblem, match="Tactoscope"):
        load_weights(path)
    save_file({"x": np.array([1.0, np.nan], np.float32)}, path)
    with pytest.raises(FileProblem, match="'x'"):
        load_weights(path)
    with pytest.raises(FileProblem, match="16 bits"):
        save_weights(path, some(scale=1e6), use_float16=True)


def test_a_changed_file_is_read_again(tmp_path):
    path = tmp_path / "some.safetensors"
    save_weights(path, some())
    first = weights_registry.load_file(path)
    assert weights_registry.load_file(path) is first
    save_weights(path, some(scale=2.0))
    os.utime(path, ns=(1, 1))
    assert weights_registry.load_file(path).content_digest != first.content_digest
    path.unlink()
    assert "No such file" in weights_registry.load_file(path).why


def test_weights_of_another_task_are_not_used(tmp_path):
    path = tmp_path / "some.safetensors"
    save_weights(path, some())
    assert isinstance(weights_registry.load_for_task("gel_depth", "gel", path), Weights)
    other = weights_registry.load_for_task("bubble_depth", "bubble", path)
    assert all(fact in other.why for fact in ("'some'", "gel_depth", "bubble_depth", "--weights"))
    assert "'unknown'" in weights_registry.load_for_task("gel_depth", "unknown", None).why


def test_shipped_weights_are_readable_and_small():
    files = sorted(weights_registry.WEIGHTS_FOLDER.glob("*.safetensors"))
    for path in files:
        assert isinstance(weights_registry.load_shipped(path.stem), Weights)
        assert path.with_suffix(".md").is_file()
        assert path.stat().st_size <= 16 << 20
    assert sum(path.stat().st_size for path in files) <= 60 << 20


def test_an_onnx_file_is_packed_and_limited(tmp_path, monkeypatch):
    path = tmp_path / "some.safetensors"
    onnx = b"\x08" + bytes(1 << 20)
    save_weights(path, some(onnx=onnx))
    assert path.stat().st_size < 1 << 16
    assert load_weights_of_package(path).read_onnx() == onnx

    content = path.read_bytes()
    path.write_bytes(content.replace(zlib.compress(onnx, 9)[:8], b"\x78" + bytes(7)))
    with pytest.raises(FileProblem, match="cannot be unpacked"):
        load_weights_of_package(path).read_onnx()
    path.write_bytes(content)
    monkeypatch.setattr(weights_module, "_MAX_ONNX_BYTES", 1 << 10)
    with pytest.raises(FileProblem, match="too many bytes"):
        load_weights_of_package(path).read_onnx()


def test_a_scalar_tensor_keeps_its_shape(tmp_path):
    """Such as the batch counter of batch normalisation."""
    save_weights(
        tmp_path / "some.safetensors",
        some(tensors={"n": np.array(7.0, np.float32), "a": np.ones((2, 1), np.float32)}),
    )
    back = load_weights(tmp_path / "some.safetensors")
    assert {name: tensor.shape for name, tensor in back.tensors.items()} == {"n": (), "a": (2, 1)}


def test_weights_of_the_package_hold_no_numbers_in_memory(tmp_path):
    path = tmp_path / "w.safetensors"
    save_weights(path, some(onnx=b"graph" * 100))
    whole = load_weights(path)
    lean = load_weights_of_package(path)
    assert lean.content_digest == whole.content_digest
    assert lean.n_parameters == whole.n_parameters > 0
    assert all(np.array_equal(lean.tensors[name], t) for name, t in whole.tensors.items())
    save_weights(path, some(onnx=b"other"))
    with pytest.raises(FileProblem, match="have changed"):
        lean.tensors["a.bias"]
    with pytest.raises(FileProblem, match="have changed"):
        lean.read_onnx()
    path.unlink()
    with pytest.raises(FileProblem, match=r"w\.safetensors"):
        lean.tensors["a.bias"]
    with pytest.raises(FileProblem, match=r"w\.safetensors"):
        lean.read_onnx()
