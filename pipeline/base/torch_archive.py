"""Tensors of a PyTorch archive, read without torch and without running code that the file asks for.

`torch.save` (since 1.6) writes a zip file: `NAME/data.pkl` describes the saved object, `NAME/data/KEY` holds the
numbers of one storage. Before, it wrote pickles one after the other, the description among them, and then the numbers
of all storages. The description is a pickle, which may name any function and have it called. Here every name
becomes a class of its own that does nothing (`_Inert`); after reading, only what describes a tensor is understood.
Callbacks, optimisers and settings of a training checkpoint stay unknown objects, and their numbers are not read.
"""

from __future__ import annotations

import contextlib
import io
import math
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.errors import FileProblem
from pipeline.base.files import describe_os_error, require_file
from pipeline.base.read_budget import require_budget

SIGNATURE = b"PK\x03\x04"  # first bytes of an archive
_MAX_DESCRIPTION_BYTES = 4 << 20  # of data.pkl; that of a checkpoint with 2,000 tensors takes 0.3 MB
_MAX_CLASSES = 10_000  # that a description names; each becomes one of some kB here
_Unpickler: Any = vars(pickle)[
    "_Unpickler"
]  # Python's own: that in C makes a table as long as any number that a file states
ZIP_ERRORS = (  # of a damaged archive: those of Python's reader have no common root
    zipfile.BadZipFile, zlib.error, struct.error, ValueError, LookupError, ArithmeticError, EOFError, RuntimeError,
    NotImplementedError,
)  # fmt: skip
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
    _open_storage: Callable[[str, int], BinaryIO]  # (key, bytes) -> its numbers; raises as a damaged file does

    def read(self, tensor: StoredTensor, report: Callable[[int], None] = lambda _n_bytes: None) -> NDArray[Any]:
        """The numbers of a tensor in its shape, bfloat16 as float32; raises FileProblem for a damaged file.

        `report` receives the number of bytes read so far, and may raise to stop.
        """
        if not tensor.numbers:
            raise FileProblem("a tensor has a type of numbers that is not supported", self.path)
        size = _get_type(tensor.numbers)
        try:
            n_bytes = tensor.n_stored * size.itemsize
            with self._open_storage(tensor.storage, n_bytes) as member:
                stored = np.empty(tensor.n_stored, size)
                _fill(memoryview(cast("Any", stored)).cast("B"), member, report)
        except (OSError, *ZIP_ERRORS) as error:
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
    require_file(path, "the file", most_bytes=1 << 50)
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(path.open("rb"))
            is_archive = file.read(len(SIGNATURE)) == SIGNATURE
            file.seek(0)
            opened = _open_archive(stack.enter_context(zipfile.ZipFile(file)), path) if is_archive else None
        except OSError as error:
            raise FileProblem(f"cannot read the file ({describe_os_error(error)})", path) from error
        except ZIP_ERRORS as error:
            raise FileProblem("the file is truncated or damaged: copy or download it again", path) from error
        yield opened or _read_legacy(file, path)


def _open_archive(archive: zipfile.ZipFile, path: Path) -> TorchArchive:
    root = find_root(archive, path)
    if f"{root}byteorder" in archive.namelist() and _read_byte_order(archive, root) == b"big":
        raise FileProblem("the numbers are in big-endian order; save the file on a PC", path)
    content = _describe(io.BytesIO(archive.read(f"{root}data.pkl")), path)
    return TorchArchive(path, content, partial(_open_member, archive, root))


def _open_member(archive: zipfile.ZipFile, root: str, key: str, n_bytes: int) -> BinaryIO:
    info = archive.getinfo(f"{root}data/{key}")
    if (info.compress_type, info.file_size) != (zipfile.ZIP_STORED, n_bytes):
        raise EOFError
    return cast("BinaryIO", archive.open(info))


def _read_legacy(file: BinaryIO, path: Path) -> TorchArchive:
    """What torch before 1.6 saved; raises FileProblem."""
    limited = _LimitedFile(file)
    for _ in range(3):  # a mark, a version, and the sizes of numbers
        _describe(limited, path)
    storages = dict[str, _Storage]()
    content, keys = _describe(limited, path, storages), _describe(limited, path)
    places, at = dict[str, tuple[int, int]](), file.tell()
    for key in keys if isinstance(keys, list) else ():
        stored = storages.get(str(key))
        if stored is None or not stored.numbers:
            raise FileProblem("the file holds numbers of a type that is not supported", path)
        at += 8  # their count
        places[str(key)] = at, stored.n_stored * _get_type(stored.numbers).itemsize
        at += places[str(key)][1]

    def open_part(key: str, n_bytes: int) -> BinaryIO:
        start, n_there = places[key]
        if n_there != n_bytes or start + n_bytes > path.stat().st_size:
            raise EOFError
        part = path.open("rb")
        part.seek(start)
        return part

    return TorchArchive(path, content, open_part)


class _LimitedFile:
    """A file of which a description is read, up to the size that one may have."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._left = file, _MAX_DESCRIPTION_BYTES

    def read(self, n: int) -> bytes:
        """The next `n` bytes; raises EOFError for too many."""
        return self._count(self._file.read(min(n, self._left + 1)))

    def readline(self) -> bytes:
        """The next line; raises EOFError for too long a one."""
        return self._count(self._file.readline(self._left + 1))

    @property
    def is_beyond(self) -> bool:
        """Whether more was asked for than a description may have."""
        return self._left < 0

    def _count(self, content: bytes) -> bytes:
        self._left -= len(content)
        if self._left < 0:
            raise EOFError
        return content


def require_short_description(path: Path) -> None:
    """Raise FileProblem where torch would take more than a moment, or more than a budget, to load a file's table.

    Whether the rest is in order is for torch to say.
    """
    with path.open("rb") as file:
        if file.read(len(SIGNATURE)) == SIGNATURE:
            with contextlib.suppress(*ZIP_ERRORS), zipfile.ZipFile(file) as archive:
                find_root(archive, path)
                folded = [m for m in archive.infolist() if m.compress_type != zipfile.ZIP_STORED]
                require_budget(sum(member.file_size for member in folded), "the compressed tensors", path)
            return
        file.seek(0)
        limited = _LimitedFile(file)
        with contextlib.suppress(Exception):  # a pickle may fail in any way
            for _ in range(4):
                _InertUnpickler(limited).load()
        if limited.is_beyond:
            raise FileProblem("the file's description of its tensors is too long; save the tensors alone", path)


def find_root(archive: zipfile.ZipFile, path: Path) -> str:
    """The folder of the members of a PyTorch file; raises FileProblem for another file, and a long description."""
    names = [name for name in archive.namelist() if name.endswith("data.pkl")]
    if not names:
        raise FileProblem("this is no PyTorch file", path)
    n_bytes = archive.getinfo(names[0]).file_size
    if n_bytes > _MAX_DESCRIPTION_BYTES:
        raise FileProblem(
            f"the file's description of its tensors states {n_bytes / 1e6:.0f} MB, where that of a network has less "
            "than one: it is damaged; save the tensors alone",
            path,
        )
    return names[0].removesuffix("data.pkl")


def _read_byte_order(archive: zipfile.ZipFile, root: str) -> bytes:
    with archive.open(f"{root}byteorder") as member:
        return member.read(8)


def _get_type(numbers: str) -> np.dtype[Any]:
    """The type in which numbers are stored."""
    return np.dtype("u2" if numbers == "bfloat16" else numbers)


def _fill(target: memoryview, member: Any, report: Callable[[int], None]) -> None:
    """Read as many bytes; raises EOFError where there are fewer."""
    done = 0
    while done < len(target):
        n = member.readinto(target[done : done + _CHUNK_BYTES])
        if not n:
            raise EOFError
        done += n
        report(done)
    member.read(1)  # compares the checksum at the end of a member


def _describe(file: Any, path: Path, storages: dict[str, _Storage] | None = None) -> Any:
    """What the next pickle of a file holds; `storages` receives those that it names."""
    try:
        unpickler = _InertUnpickler(file)
        content = _resolve(unpickler.load(), {})
    except Exception as error:  # a pickle may fail in any way
        raise FileProblem("the file is truncated or damaged: its description cannot be read", path) from error
    if storages is not None:
        storages |= unpickler.storages
    return content


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


class _InertUnpickler(_Unpickler):
    """Builds plain values and `_Inert` objects; imports and calls nothing that the file names."""

    def __init__(self, file: Any) -> None:
        super().__init__(file)
        self._classes = dict[str, type[_Inert]]()
        self.storages = dict[str, _Storage]()

    def find_class(self, module: str, name: str, /) -> Any:
        """A class without effect, whatever is named; raises UnpicklingError for too many."""
        path = f"{module}.{name}"
        if path not in self._classes:
            if len(self._classes) >= _MAX_CLASSES:
                raise pickle.UnpicklingError("too many classes")
            self._classes[path] = type("Inert", (_Inert,), {"path": path})
        return self._classes[path]

    def persistent_load(self, pid: Any, /) -> Any:
        """The storage of a tensor: ("storage", type, key, device, count), and a view that torch no longer writes."""
        _, kind, key, _, count = pid[:5]
        name = str(getattr(kind, "path", "")).rpartition(".")[2]
        self.storages[str(key)] = storage = _Storage(str(key), _TYPES.get(name, ""), int(count))
        return storage


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
