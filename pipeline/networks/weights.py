"""Weights of a network as a value, and the one file that they are kept in: safetensors, with a card beside it.

Loads no torch: what a method reads is known, and its key made, before any network is built.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Floats, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.files import open_atomic, read_bytes, write_text
from pipeline.base.params import Value
from pipeline.engine.digests import UNDIGESTED, compute_digest

SUFFIX = ".safetensors"
_WHAT = "the weights"
_MARK = "tactoscope weights"  # key of the header, whose value is the version of what stands beside it
_VERSION = "1"
_ONNX = "onnx"  # name of the tensor of bytes that holds the ONNX file
_FLOATS = {"F64": np.float64, "F32": np.float32, "F16": np.float16}
_COUNTS = {"I64": np.int64, "I32": np.int32, "I16": np.int16, "I8": np.int8, "U8": np.uint8, "BOOL": np.bool_}


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """All that makes a network: which one, with what arguments, and the numbers learned."""

    name: str  # for people: that of the file
    kind: str  # of `pipeline.networks.network_factory.KINDS`
    config: Mapping[str, Value] = field(metadata=UNDIGESTED)  # arguments of the network's class
    tensors: Mapping[str, Floats] = field(metadata=UNDIGESTED)  # by their names in the network
    card: Mapping[str, str] = field(default_factory=dict, metadata=UNDIGESTED)  # how they came about, in words
    onnx: bytes = field(
        default=b"", metadata=UNDIGESTED, repr=False
    )  # the network as an ONNX file; b"" if not exported
    content_digest: str = field(init=False)  # digest of kind, config and tensors: all that a result depends on

    def __post_init__(self) -> None:
        """Freeze the tensors and work out their digest, once."""
        for tensor in self.tensors.values():
            freeze(tensor)
        object.__setattr__(self, "content_digest", compute_digest((self.kind, dict(self.config), dict(self.tensors))))

    @property
    def n_parameters(self) -> int:
        """How many numbers were learned."""
        return sum(tensor.size for tensor in self.tensors.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class NoWeights:
    """What a method reads where there are no weights that it could use."""

    why: str  # one sentence


def load_weights(path: Path) -> Weights:
    """The weights in a file of ours, all as float32; raises FileProblem for what is missing, damaged or foreign."""
    metadata, entries = _read_entries(path)
    onnx = bytes(entries.pop(_ONNX)["data"]) if _ONNX in entries else b""
    tensors = _convert_entries(entries, path)
    if not is_tactoscope_file(metadata):
        raise FileProblem("these weights do not say which network they are for; give a file that Tactoscope made", path)
    try:
        config, card = (cast("dict[str, Any]", json.loads(metadata[key])) for key in ("config", "card"))
        kind = metadata["kind"]
        plain = all(isinstance(value, (bool, int, float, str)) for value in config.values())
    except (KeyError, ValueError, AttributeError) as error:
        raise FileProblem(f"{_WHAT} are damaged: their header cannot be read", path) from error
    if not plain:
        raise FileProblem(f"{_WHAT} are damaged: their header holds more than plain settings", path)
    card = {str(key): str(value) for key, value in card.items()}
    return Weights(name=path.stem, kind=kind, config=config, tensors=tensors, onnx=onnx, card=card)


def is_tactoscope_file(metadata: Mapping[str, str]) -> bool:
    """Whether the header of a safetensors file says that it was written here."""
    return metadata.get(_MARK) == _VERSION


def load_tensors(path: Path) -> tuple[dict[str, str], dict[str, Floats]]:
    """Header and tensors of any safetensors file, halves of either sort as float32; raises FileProblem."""
    metadata, entries = _read_entries(path)
    return metadata, _convert_entries(entries, path)


def _read_entries(path: Path) -> tuple[dict[str, str], dict[str, Mapping[str, Any]]]:
    """Header and raw tensors of a safetensors file: name -> dtype, shape, data; raises FileProblem."""
    from safetensors import SafetensorError, deserialize

    content = read_bytes(path, _WHAT)
    try:
        entries = deserialize(content)
        length = int.from_bytes(content[:8], "little")
        header = cast("dict[str, Any]", json.loads(content[8 : 8 + length]))
    except (SafetensorError, ValueError) as error:
        raise FileProblem(
            f"{_WHAT} cannot be read: the file is cut short or damaged, or no safetensors", path
        ) from error
    metadata = cast("dict[str, Any]", header.get("__metadata__") or {})
    return {str(k): str(v) for k, v in metadata.items()}, dict(entries)


def _convert_entries(entries: Mapping[str, Mapping[str, Any]], path: Path) -> dict[str, Floats]:
    """The tensors as float32; raises FileProblem for unknown types and values that are not finite."""
    tensors: dict[str, Floats] = {}
    for name, entry in entries.items():
        tensor = _as_float(entry)
        if tensor is None:
            raise FileProblem(f"{_WHAT} hold {name!r} as {entry['dtype']}, which is not known here", path)
        if not np.isfinite(tensor).all():
            raise FileProblem(f"{_WHAT} hold values that are not numbers (in {name!r}); train or fetch them anew", path)
        tensors[name] = tensor
    return tensors


def save_weights(path: Path, weights: Weights, *, use_float16: bool = False) -> None:
    """Write weights and, beside them, their card as Markdown; `half` keeps them in 16 bits. Raises FileProblem."""
    from safetensors.numpy import save as to_bytes

    with np.errstate(over="ignore"):  # what is too large for 16 bits is told below
        kind = np.float16 if use_float16 else np.float32
        stored: dict[str, NDArray[Any]] = {
            name: np.asarray(tensor, kind, order="C") for name, tensor in weights.tensors.items()
        }
    if not all(np.isfinite(tensor).all() for tensor in stored.values()):
        raise FileProblem(
            f"{_WHAT} hold values that no {16 if use_float16 else 32} bits can keep; nothing is written", path
        )
    if weights.onnx:
        stored[_ONNX] = np.frombuffer(weights.onnx, np.uint8)
    header = {
        _MARK: _VERSION, "kind": weights.kind,
        "config": json.dumps(dict(weights.config)), "card": json.dumps(dict(weights.card)),
    }  # fmt: skip
    with open_atomic(path, _WHAT) as file:
        file.write(to_bytes(stored, header))
    write_text(path.with_suffix(".md"), _card(path.stem, weights), "the card of the weights")


def _card(name: str, weights: Weights) -> str:
    """What a person wants to know of them before using them."""
    settings = ", ".join(f"{key} {value}" for key, value in weights.config.items())
    rows = {"network": f"{weights.kind} ({settings})", "numbers": f"{weights.n_parameters:,}", **weights.card}
    return f"# {name}\n\n" + "".join(f"- {key}: {value}\n" for key, value in rows.items())


def _as_float(entry: Mapping[str, Any]) -> Floats | None:
    """A tensor of a file as float32 in memory of its own, None for a type that numpy does not have."""
    kind, raw = str(entry["dtype"]), bytes(entry["data"])
    if kind == "BF16":  # the upper half of a float32
        wide: NDArray[Any] = (np.frombuffer(raw, np.uint16).astype(np.uint32) << 16).view(np.float32)
    elif kind in _FLOATS or kind in _COUNTS:
        wide = np.frombuffer(raw, _FLOATS.get(kind) or _COUNTS[kind]).astype(np.float32)
    else:
        return None
    return wide.reshape(entry["shape"])
