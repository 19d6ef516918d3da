"""Archives of torch are read as torch reads them, and whatever else they name stays without
effect.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import struct
import sys
import types
import zipfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.core.errors import FileProblem
from pipeline.core.torch_archive import Inert, load_torch_file, require_checksums


def read(path, *keys):
    require_checksums(path)
    content = load_torch_file(path)
    for key in keys:
        content = content[key]
    return content


def test_a_nested_state_dict_is_a_mapping(tmp_path):
    state = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.BatchNorm1d(3)).state_dict()
    torch.save(
        {"epoch": 3, "state_dict": state, "of": defaultdict(list, a=[1])}, tmp_path / "s.ckpt"
    )
    content = load_torch_file(tmp_path / "s.ckpt")
    assert list(content["state_dict"]) == list(state)
    assert content["epoch"] == 3


class Runs:
    """Whatever a pickle may ask for when it is loaded: here a folder is made."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return os.makedirs, (str(self.marker), 0o777, True)


class Rebuilds(Runs):
    """The same, with a state, elements and items for what the call gives."""

    def __reduce__(self):
        code = (
            f"__import__('os').makedirs({str(self.marker)!r}, exist_ok=True) or "
            "__import__('argparse').Namespace()"
        )
        return eval, (code,), {"x": 1}


class MakesNamespace(Runs):
    """An object of a class that is importable and does not matter."""

    def __reduce__(self):
        return argparse.Namespace, (), {"x": 1}


@pytest.mark.parametrize("hostile", [Runs, Rebuilds])
@pytest.mark.parametrize("protocol", [2, 4])
def test_nothing_that_a_file_names_is_run(tmp_path, hostile, protocol):
    marker = tmp_path / "ran"
    path = tmp_path / "hostile.pt"
    torch.save(
        {"weight": torch.ones(2), "x": hostile(marker), "y": [hostile(marker)]},
        path,
        pickle_protocol=protocol,
    )
    with contextlib.suppress(FileProblem):
        assert read(path, "weight").tolist() == [1.0, 1.0]
    assert not marker.exists()
    torch.load(path, weights_only=False)  # the attack is one
    assert marker.exists()


def test_other_objects_of_a_checkpoint_do_not_matter_and_are_refused_among_tensors_alone(tmp_path):
    torch.save({"weight": torch.ones(2), "x": MakesNamespace(tmp_path)}, tmp_path / "a.pt")
    assert read(tmp_path / "a.pt", "weight").tolist() == [1.0, 1.0]
    assert isinstance(read(tmp_path / "a.pt", "x"), Inert)
    with pytest.raises(FileProblem, match="more than tensors"):
        load_torch_file(tmp_path / "a.pt", only_tensors=True)


def rewritten(path: Path, description: bytes) -> Path:
    with zipfile.ZipFile(path.with_name("made.pt"), "w") as archive:
        archive.writestr("archive/data.pkl", description)
        archive.writestr("archive/version", "3")
        archive.writestr("archive/data/0", np.ones(4, np.float32).tobytes())
    return path.with_name("made.pt")


GLOBAL = b"cposix\nsystem\n"


@pytest.mark.parametrize(
    "description",
    [
        GLOBAL + b"(S'touch MARKER'\ntR.",
        b"(S'touch MARKER'\niposix\nsystem\n.",
        GLOBAL + b"(S'touch MARKER'\nt\x81.",
        b"\x80\x04\x8c\x05posix\x8c\x06system\x93\x8c\x0ctouch MARKER\x85R.",
        GLOBAL + b"}(S'__setstate__'\nNub.",
        GLOBAL + b"N}(S'__init__'\nNu\x86b.",
        b"cbuiltins\ngetattr\n(S'a'\nS'__class__'\ntR.",
        b"\x82\x01.",
        b"ccollections\nOrderedDict\n)R}(S'__class__'\nNub.",
        b"(lp0\ng0\na.",
        b"",
        b"\x80",
    ],
    ids=range(12),
)
def test_any_description_is_inert_or_refused(tmp_path, monkeypatch, description):
    monkeypatch.chdir(tmp_path)
    ran = []
    monkeypatch.setattr(os, "system", ran.append)
    with contextlib.suppress(FileProblem):
        load_torch_file(rewritten(tmp_path / "x", description))
    assert not (tmp_path / "MARKER").exists()
    assert not ran


def test_unknown_classes_are_not_imported(tmp_path, monkeypatch):
    """A pytorch-lightning checkpoint is read where that package is not installed."""
    module = types.ModuleType("not_installed")
    module.ModelCheckpoint = type("ModelCheckpoint", (), {"__module__": "not_installed"})
    monkeypatch.setitem(sys.modules, "not_installed", module)
    torch.save(
        {"callbacks": {module.ModelCheckpoint: {"best": 1}}, "w": torch.ones(1)},
        tmp_path / "a.ckpt",
    )
    monkeypatch.delitem(sys.modules, "not_installed")
    assert read(tmp_path / "a.ckpt", "w").tolist() == [1.0]
    assert "not_installed" not in sys.modules


def described(offset=0, shape=(4,), strides=(1,), count=4, kind="FloatStorage"):
    """The pickle of a tensor with these figures, as torch writes it."""

    def text(word):
        return b"X" + struct.pack("<I", len(word)) + word.encode()

    def numbers(*values):
        return b"(" + b"".join(b"\x8a\x08" + struct.pack("<q", value) for value in values) + b"t"

    long = b"\x8a\x08" + struct.pack("<q", count)
    storage = (
        b"("
        + text("storage")
        + f"ctorch\n{kind}\n".encode()
        + text("0")
        + text("cpu")
        + long
        + b"tQ"
    )
    offset = b"\x8a\x08" + struct.pack("<q", offset)
    backward_hooks = b"\x89ccollections\nOrderedDict\n)R"
    figures = storage + offset + numbers(*shape) + numbers(*strides) + backward_hooks
    return b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n(" + figures + b"tR."


def test_the_made_description_is_one(tmp_path):
    assert read(rewritten(tmp_path / "x", described())).tolist() == [1.0] * 4


@pytest.mark.parametrize(
    "figures",
    [
        {"offset": 1},
        {"offset": -1},
        {"shape": (5,)},
        {"strides": (2,)},
        {"strides": (-1,)},
        {"shape": (2, 2), "strides": (4, 1)},
        {"count": 1 << 50, "shape": (1 << 50,)},
    ],
)
def test_a_tensor_beyond_its_storage_is_refused(tmp_path, figures):
    with pytest.raises(FileProblem, match="damaged"):
        read(rewritten(tmp_path / "x", described(**figures)))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused_in_a_sentence(tmp_path, share):
    path = tmp_path / "cut.ckpt"
    torch.save({"w": torch.ones(1000)}, path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileProblem, match="damaged"):
        read(path, "w")


def test_a_changed_byte_of_a_tensor_is_noticed(tmp_path):
    path = tmp_path / "rotten.pt"
    torch.save({"w": torch.full((1000,), 3.0)}, path)
    content = bytearray(path.read_bytes())
    content[content.index(np.full(9, 3.0, np.float32).tobytes()) + 8] ^= 1
    path.write_bytes(content)
    with pytest.raises(FileProblem, match="a tensor is damaged"):
        read(path, "w")


def test_a_zip_file_without_a_description_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "other.pt", "w") as archive:
        archive.writestr("a.txt", "a")
    with pytest.raises(FileProblem, match="not a PyTorch file"):
        read(tmp_path / "other.pt")
