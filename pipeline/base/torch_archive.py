"""Tensors of a PyTorch archive, read without torch and without running code that the file asks for.

`torch.save` (since 1.6) writes a zip file: `NAME/data.pkl` describes the saved object, `NAME/data/KEY` holds the
numbers of one storage. The description is a pickle, which may name any function and have it called. Here every name
becomes a class of its own that does nothing (`_Inert`); after reading, only what describes a tensor is understood.
Callbacks, optimisers and settings of a training checkpoint stay unknown objects, and their numbers are not read.
"""

from __future__ import annotations

import math
import pickle
import zipfile
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.errors import FileProblem
from pipeline.base.files import describe_os_error

SIGNATURE = b"PK\x03\x04"  # first bytes of an archive
_MAX_DESCRIPTION_BYTES = 256 << 20  # of data.pkl; that of a checkpoint with 2,000 tensors takes 0.3 MB
_CHUNK_BYTES = 16 << 20
_TYPES = {  # class of a storage -> type of its numbers
    "FloatStorage": "f4", "DoubleStorage": "f8", "HalfStorage": "f2", "BFloat16Storage": "bfloat16",
    "LongStorage": "i8", "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1", "ByteStorage": "u1",
    "BoolStorage": "?",
}  # fmt: skip
_TENSOR = ("torch._utils._rebuild_tensor_v2", "torch._utils._rebuild_tensor")
_PARAMETER = ("torch._utils._rebuild_parameter", "torch._utils._rebuild_parameter_with_state")


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTensor:
    """Where the numbers of a tensor lie in its archive."""

    storage: str  # key of the storage
    numbers: str  # type, a value of `_TYPES`; "" = one that is not read
    n_stored: int  # numbers in the storage
    offset: int  # of the first number, in numbers
    shape: tuple[int, ...]
    strides: tuple[int, ...]  # in numbers


@dataclass(frozen=True, slots=True)
class TorchArchive:
    """An open archive: what was saved, and a reader of its tensors."""

    path: Path
    content: Any  # mappings, lists, plain values and `StoredTensor`; None for objects of any other class
    _zip: zipfile.ZipFile
    _root: str  # folder of the members

    def read(self, tensor: StoredTensor, report: Callable[[int], None] = lambda _n_bytes: None) -> NDArray[Any]:
        """The numbers of a tensor in its shape, bfloat16 as float32; raises FileProblem for a damaged file.

        `report` receives the number of bytes read so far, and may raise to stop.
        """
        if not tensor.numbers:
            raise FileProblem("a tensor has a type of numbers that is not supported", self.path)
        size = np.dtype("u2" if tensor.numbers == "bfloat16" else tensor.numbers)
        try:
            info = self._zip.getinfo(f"{self._root}data/{tensor.storage}")
            if (info.compress_type, info.file_size) != (zipfile.ZIP_STORED, tensor.n_stored * size.itemsize):
                raise EOFError
            stored = np.empty(tensor.n_stored, size)
            with self._zip.open(info) as member:
                _fill(memoryview(cast("Any", stored)).cast("B"), member, report)
        except (KeyError, EOFError, OSError, zipfile.BadZipFile, NotImplementedError) as error:
            raise FileProblem("a tensor is damaged or missing: copy or download the file again", self.path) from error
        values = np.lib.stride_tricks.as_strided(
            stored[tensor.offset :], tensor.shape, tuple(n * size.itemsize for n in tensor.strides), writeable=False
        )
        if tensor.numbers == "bfloat16":
            return (values.astype(np.uint32) << 16).view(np.float32)
        return values


@contextmanager
def open_torch_archive(path: Path) -> Generator[TorchArchive]:
    """Yield the archive; raises FileProblem for a missing, truncated or foreign file."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.endswith("data.pkl")]
            if not names or archive.getinfo(names[0]).file_size > _MAX_DESCRIPTION_BYTES:
                raise FileProblem("this is no PyTorch file", path)
            root = names[0].removesuffix("data.pkl")
            if f"{root}byteorder" in archive.namelist() and archive.read(f"{root}byteorder") == b"big":
                raise FileProblem("the numbers are in big-endian order; save the file on a PC", path)
            content = _describe(archive, names[0], path)
            yield TorchArchive(path, content, archive, root)
    except zipfile.BadZipFile as error:
        raise FileProblem("the file is truncated or damaged: copy or download it again", path) from error
    except OSError as error:
        raise FileProblem(f"cannot read the file ({describe_os_error(error)})", path) from error


def _fill(target: memoryview, member: Any, report: Callable[[int], None]) -> None:
    """Read a member of exactly this length; raises EOFError."""
    done = 0
    while done < len(target):
        n = member.readinto(target[done : done + _CHUNK_BYTES])
        if not n:
            raise EOFError
        done += n
        report(done)
    if member.read(1):  # also compares the checksum
        raise EOFError


def _describe(archive: zipfile.ZipFile, name: str, path: Path) -> Any:
    try:
        with archive.open(name) as file:
            return _resolve(_InertUnpickler(file).load(), {})
    except zipfile.BadZipFile:
        raise
    except Exception as error:  # a pickle may fail in any way
        raise FileProblem("the file is damaged: its description cannot be read", path) from error


class _Inert:
    """An object of a class or function that the file names: it keeps its arguments and items and does nothing."""

    path: ClassVar[str]  # module and name

    def __new__(cls, *args: Any, **_named: Any) -> _Inert:
        inert = super().__new__(cls)
        inert.args, inert.items = args, {}
        return inert

    def __init__(self, *_args: Any, **_named: Any) -> None:
        self.args: tuple[Any, ...]
        self.items: dict[Any, Any]

    def __setstate__(self, state: object) -> None:
        """Ignore the attributes that the file sets."""

    def __setitem__(self, key: Any, value: Any) -> None:
        self.items[key] = value

    def append(self, value: object) -> None:
        """Ignore an element of a list."""

    def extend(self, values: object) -> None:
        """Ignore elements of a list."""

    def add(self, value: object) -> None:
        """Ignore an element of a set."""


@dataclass(frozen=True, slots=True)
class _Storage:
    key: str
    numbers: str
    n_stored: int


class _InertUnpickler(pickle.Unpickler):
    """Builds plain values and `_Inert` objects; imports and calls nothing that the file names."""

    def find_class(self, module: str, name: str, /) -> Any:
        """A new class without effect, whatever is named."""
        return type("Inert", (_Inert,), {"path": f"{module}.{name}"})

    def persistent_load(self, pid: Any, /) -> Any:
        """The storage of a tensor: ("storage", type, key, device, count)."""
        _, kind, key, _, count = pid
        name = str(getattr(kind, "path", "")).rpartition(".")[2]
        return _Storage(str(key), _TYPES.get(name, ""), int(count))


def _resolve(value: Any, known: dict[int, Any]) -> Any:
    """The value with tensors described, and None for all objects that are neither plain nor mappings."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if id(value) in known:  # shared, or within itself
        return known[id(value)]
    known[id(value)] = None
    known[id(value)] = found = _resolve_object(value, known)
    return found


def _resolve_object(value: Any, known: dict[int, Any]) -> Any:
    if isinstance(value, _Inert):
        if value.path in _PARAMETER and value.args:
            return _resolve(value.args[0], known)
        if value.path in _TENSOR:
            return _describe_tensor(*value.args[:4])
        return {key: _resolve(item, known) for key, item in value.items.items()} if value.items else None
    if isinstance(value, dict):
        return {key: _resolve(item, known) for key, item in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, (list, tuple)):
        return [_resolve(item, known) for item in cast("tuple[Any, ...]", value)]
    return None


def _describe_tensor(storage: Any, offset: Any, shape: Any, strides: Any) -> StoredTensor:
    """Raises ValueError for a tensor that reaches beyond its storage."""
    if not isinstance(storage, _Storage):
        raise ValueError("a tensor without a storage")
    shape, strides = (tuple(int(n) for n in numbers) for numbers in (shape, strides))
    count = math.prod(shape)
    last = int(offset) + sum((n - 1) * stride for n, stride in zip(shape, strides, strict=True))
    if min((0, int(offset), *shape, *strides)) < 0 or count > storage.n_stored or (count and last >= storage.n_stored):
        raise ValueError("a tensor reaches beyond its storage")
    return StoredTensor(
        storage=storage.key, numbers=storage.numbers, n_stored=storage.n_stored, offset=int(offset), shape=shape,
        strides=strides,
    )  # fmt: skip
