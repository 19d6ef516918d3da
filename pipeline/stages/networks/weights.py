"""Weights of a network as a value and as a safetensors file with a model card.

Loads no torch: what a method reads is known, and its cache key computed, before a network is built.
"""

from __future__ import annotations

import copy
import json
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, freeze
from pipeline.core.digests import UNDIGESTED, compute_digest
from pipeline.core.errors import FileProblem
from pipeline.core.files import (
    MOST_NETWORK_BYTES,
    open_atomic,
    require_budget,
    require_file,
    write_text,
)
from pipeline.core.frozen import frozen
from pipeline.core.params import Value
from pipeline.core.torch_archive import SIGNATURE
from pipeline.core.typed_data import Name, Plain, convert
from pipeline.stages.networks.devices import PROCESSOR

SUFFIX = ".safetensors"
_WHAT = "the weights"
_HEADER_KEY = "tactoscope weights"  # header key; its value is the version of the header
_VERSION = "1"
# name of the tensor of bytes that holds the ONNX file, compressed by zlib or as it is
_ONNX = "onnx"
_ZLIB = b"\x78"  # first byte of a zlib stream; no ONNX file begins with it
_MAX_ONNX_BYTES = 1 << 28  # of an unpacked ONNX file; the largest that is shipped has 8 MB
# names of safetensors -> numpy's
_TYPES = {
    "F64": "f8",
    "F32": "f4",
    "F16": "f2",
    "I64": "i8",
    "I32": "i4",
    "I16": "i2",
    "I8": "i1",
    "U8": "u1",
    "BOOL": "?",
}


@dataclass(frozen=True, slots=True)
class OnnxOnDisk:
    """The ONNX file inside a file of weights, read when it is needed."""

    path: Path
    stamp: tuple[int, int]  # of the file when it was opened

    def read(self) -> bytes:
        """The ONNX file; raises FileProblem where the file of weights is gone, damaged or
        another one.
        """
        _require_same(self.path, self.stamp)
        return _unpack_onnx(bytes(_read_entries(self.path)[1][_ONNX]["data"]), self.path)


@dataclass(frozen=True, slots=True)
class TensorsOnDisk(Mapping[str, Floats]):
    """The tensors of a file of weights by name, each read when it is needed."""

    path: Path
    names: tuple[str, ...]
    stamp: tuple[int, int]  # of the file when it was opened

    def __getitem__(self, name: str) -> Floats:
        """One tensor as float32; raises FileProblem where the file is gone, damaged or another
        one.
        """
        from safetensors import SafetensorError, safe_open

        if name not in self.names:
            raise KeyError(name)
        _require_same(self.path, self.stamp)
        try:
            with safe_open(self.path, framework="numpy") as file:
                return freeze(np.asarray(file.get_tensor(name), np.float32))
        except (OSError, SafetensorError) as error:
            raise FileProblem(f"cannot read {_WHAT} again", self.path) from error

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


@frozen
class Weights:
    """A trained network: its kind, constructor arguments and parameters."""

    name: str  # of the file
    kind: str  # of `network_factory.NETWORK_CLASSES`
    config: Mapping[str, Value] = field(metadata=UNDIGESTED)  # constructor arguments of the network
    tensors: Mapping[str, Floats] = field(metadata=UNDIGESTED)  # by name in the network
    # entries of the model card
    card: Mapping[str, str] = field(default_factory=dict, metadata=UNDIGESTED)
    onnx: bytes | OnnxOnDisk = field(
        default=b"", metadata=UNDIGESTED, repr=False
    )  # the network as an ONNX file; b"" if not exported
    placement: str = PROCESSOR  # device and precision of the network, which results depend on
    # of kind, config and tensors: all that results depend on
    content_digest: str = field(init=False)
    n_parameters: int = field(init=False, metadata=UNDIGESTED)  # trained ones

    def __post_init__(self) -> None:
        """Freeze the tensors, count them and compute their digest once."""
        n_parameters = sum(freeze(tensor).size for tensor in self.tensors.values())
        digest = compute_digest((self.kind, dict(self.config), dict(self.tensors)))
        object.__setattr__(self, "n_parameters", n_parameters)
        object.__setattr__(self, "content_digest", digest)

    def place(self, placement: str) -> Weights:
        """Return the same weights for a network elsewhere; nothing is copied."""
        if placement == self.placement:
            return self
        placed = copy.copy(self)
        object.__setattr__(placed, "placement", placement)
        return placed

    @property
    def trained_with_condition_dropout(self) -> bool:
        """Whether guidance can act on a network that samples: in training, some examples lacked the
        condition.

        `guidance.NO_CONDITION_DROPOUT` is the reason to show where it cannot.
        """
        return bool(self.config.get("trained_with_condition_dropout", True))

    def read_onnx(self) -> bytes:
        """The ONNX file; b"" if not exported; raises FileProblem where it was read from a file
        that is gone.
        """
        return self.onnx if isinstance(self.onnx, bytes) else self.onnx.read()


class _Header(msgspec.Struct):
    kind: Name
    config: dict[Name, Plain]
    card: dict[Name, Annotated[str, Meta(max_length=1_000_000)]]


@frozen
class NoWeights:
    """Input of a method that has no usable weights."""

    why: str  # reason, one sentence


def load_weights_of_package(path: Path) -> Weights:
    """`load_weights` of a file that stays where it is: its numbers are read again when a network is
    built of them.

    A network that OpenCV answers needs none of them afterwards. Raises what `load_weights` does.
    """
    require_file(path, _WHAT)
    stamp = stamp_file(path)
    weights, has_onnx = _load(path)
    object.__setattr__(weights, "tensors", TensorsOnDisk(path, tuple(weights.tensors), stamp))
    if has_onnx:
        object.__setattr__(weights, "onnx", OnnxOnDisk(path, stamp))
    return weights


def stamp_file(path: Path) -> tuple[int, int]:
    """Modification time and size of a file; raises OSError or ValueError."""
    status = path.stat()
    return status.st_mtime_ns, status.st_size


def _require_same(path: Path, stamp: tuple[int, int]) -> None:
    try:
        is_same = stamp_file(path) == stamp
    except OSError as error:
        raise FileProblem(f"{_WHAT} cannot be read again", path) from error
    if not is_same:
        raise FileProblem(
            f"{_WHAT} have changed since they were opened; open the recording again", path
        )


def load_weights(path: Path) -> Weights:
    """The weights of a Tactoscope file, as float32.

    Raises FileProblem for a missing, damaged or foreign file.

    Its ONNX graph is left: OpenCV runs a graph as it is, and one from a stranger could end the
    process, or never end. The network of the tensors is exported instead.
    """
    return _load(path)[0]


def _load(path: Path) -> tuple[Weights, bool]:
    """(weights without their ONNX graph, whether the file holds one)."""
    metadata, entries = _read_entries(path)
    has_onnx = entries.pop(_ONNX, None) is not None
    tensors = _convert_entries(entries, path)
    if not is_tactoscope_file(metadata):
        raise FileProblem(
            "these weights do not name their network; use a file written by Tactoscope", path
        )
    try:
        parsed = {key: json.loads(metadata.get(key, "null")) for key in ("config", "card")}
        header = {**metadata, **parsed}
    except (ValueError, RecursionError) as error:
        raise FileProblem(f"{_WHAT} are damaged: their header cannot be read", path) from error
    said = convert(header, _Header, _WHAT, path)
    weights = Weights(
        name=path.stem, kind=said.kind, config=said.config, tensors=tensors, card=said.card
    )
    return weights, has_onnx


def _unpack_onnx(stored: bytes, path: Path) -> bytes:
    """The ONNX file of a tensor of bytes.

    Raises FileProblem for one that is damaged or unpacks to too much.
    """
    if not stored.startswith(_ZLIB):
        return stored
    stream = zlib.decompressobj()
    try:
        onnx = stream.decompress(stored, _MAX_ONNX_BYTES)
    except zlib.error as error:
        raise FileProblem(
            f"{_WHAT} are damaged: their ONNX graph cannot be unpacked", path
        ) from error
    if not stream.eof:
        raise FileProblem(
            f"{_WHAT} are damaged: their ONNX graph is truncated or unpacks to too many bytes", path
        )
    return onnx


def is_tactoscope_file(metadata: Mapping[str, str]) -> bool:
    """Whether the header of a safetensors file was written by Tactoscope."""
    return metadata.get(_HEADER_KEY) == _VERSION


def load_tensors(path: Path) -> tuple[dict[str, str], dict[str, Floats]]:
    """Header and tensors of any safetensors file, 16-bit floats as float32; raises FileProblem."""
    metadata, entries = _read_entries(path)
    return metadata, _convert_entries(entries, path)


def _read_entries(path: Path) -> tuple[dict[str, str], dict[str, Mapping[str, Any]]]:
    """Header and raw tensors of a safetensors file: name -> dtype, shape, data.

    Raises FileProblem.
    """
    from safetensors import SafetensorError, deserialize, safe_open

    _refuse_torch_archive(path)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            names = file.keys()
            sizes = [math.prod(file.get_slice(name).get_shape()) for name in names]
        require_budget(4 * sum(sizes), _WHAT, path, most=MOST_NETWORK_BYTES)
        entries = dict(deserialize(path.read_bytes()))
    except (SafetensorError, ValueError, RecursionError, OSError) as error:
        raise FileProblem(
            f"cannot read {_WHAT}: the file is truncated, damaged or not safetensors", path
        ) from error
    return metadata, entries


def is_safetensors(path: Path) -> bool:
    """Whether a file, whatever its name, begins with the length of a header and that header.

    Raises FileProblem.
    """
    return read_head(path)[8:] == b"{"


def read_head(path: Path) -> bytes:
    """The first bytes of a file of weights, which tell its kind; raises FileProblem."""
    require_file(path, _WHAT, most_bytes=1 << 50)
    with path.open("rb") as file:
        return file.read(9)


def _refuse_torch_archive(path: Path) -> None:
    if read_head(path).startswith(SIGNATURE):
        raise FileProblem(
            f"{_WHAT} are a PyTorch file, which this method does not read; choose one that does, "
            "such as "
            "depth=unet, depth=depth_anything, touch=latent or touch=vqvae",
            path,
        )


def _convert_entries(entries: Mapping[str, Mapping[str, Any]], path: Path) -> dict[str, Floats]:
    """The tensors as float32; raises FileProblem for unknown types and values that are not
    finite.
    """
    tensors = {name: _as_float(entry, name, path) for name, entry in entries.items()}
    for name, tensor in tensors.items():
        if not np.isfinite(tensor).all():
            raise FileProblem(
                f"{_WHAT} contain NaN or infinity in {name!r}; train or download them again", path
            )
    return tensors


def save_weights(path: Path, weights: Weights, *, use_float16: bool = False) -> None:
    """Write weights and their model card (.md).

    `use_float16` stores 16 bits. Raises FileProblem.
    """
    from safetensors.numpy import save as to_bytes

    with np.errstate(over="ignore"):  # overflow of 16 bits is reported below
        dtype = np.float16 if use_float16 else np.float32
        stored: dict[str, NDArray[Any]] = {
            name: np.asarray(tensor, dtype, order="C") for name, tensor in weights.tensors.items()
        }
    if not all(np.isfinite(tensor).all() for tensor in stored.values()):
        raise FileProblem(
            f"{_WHAT} hold values beyond the range of {16 if use_float16 else 32} bits; nothing "
            "is written",
            path,
        )
    if weights.onnx:
        stored[_ONNX] = np.frombuffer(zlib.compress(weights.read_onnx(), 9), np.uint8)
    header = {
        _HEADER_KEY: _VERSION,
        "kind": weights.kind,
        "config": json.dumps(dict(weights.config)),
        "card": json.dumps(dict(weights.card)),
    }
    with open_atomic(path, _WHAT, load_weights) as file:
        file.write(to_bytes(stored, header))
    write_text(
        path.with_suffix(".md"), _format_card(path.stem, weights), "the card of the weights", None
    )


def _format_card(name: str, weights: Weights) -> str:
    """Model card: a Markdown table of network, parameters and card entries."""
    settings = ", ".join(f"{key} {value}" for key, value in weights.config.items())
    # JSON, for programs
    card = {key: value for key, value in weights.card.items() if key != "recipe"}
    rows = {
        "network": f"{weights.kind} ({settings})",
        "parameters": f"{weights.n_parameters:,}",
        **card,
    }
    table = "".join(
        f"| {key} | {' '.join(str(value).split()).replace('|', '/')} |\n"
        for key, value in rows.items()
    )
    return f"# {name}\n\n| | |\n|---|---|\n{table}"


def _as_float(entry: Mapping[str, Any], name: str, path: Path) -> Floats:
    """A tensor of a file as float32 in its own memory; raises FileProblem for unknown types."""
    kind = str(entry["dtype"])
    raw = bytes(entry["data"])
    if kind == "BF16":  # the upper half of a float32
        wide: NDArray[Any] = (np.frombuffer(raw, np.uint16).astype(np.uint32) << 16).view(
            np.float32
        )
    elif kind in _TYPES:
        wide = np.frombuffer(raw, _TYPES[kind]).astype(np.float32)
    else:
        raise FileProblem(f"{_WHAT} hold {name!r} in the unsupported type {kind}", path)
    return wide.reshape(entry["shape"])
