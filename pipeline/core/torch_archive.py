"""PyTorch files, loaded by torch without running code that they name, and without filling the
memory.

`torch.load(weights_only=True)` refuses names that it does not know, such as callbacks of a training
checkpoint. Where the other contents do not matter, each becomes a class that does nothing. What
torch does not check is checked before: the length of the description, which a few bytes can unfold
to gigabytes, and the checksums of the numbers.
"""

import contextlib
import pickle
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

from pipeline.core.errors import FileProblem, is_utf8_encodable
from pipeline.core.files import describe_os_error, require_budget, require_file

SIGNATURE = b"PK\x03\x04"  # first bytes of an archive; before torch 1.6 a file is several pickles
PICKLE_SIGNATURE = b"\x80"  # a pickle's protocol mark
# of data.pkl; that of a checkpoint with 2,000 tensors takes 0.3 MB
_MAX_DESCRIPTION_BYTES = 4 << 20
_MAX_CLASSES = 1_000  # that a description names and torch does not know
ZIP_ERRORS = (  # of a damaged archive: those of Python's reader have no common root
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    ValueError,
    LookupError,
    ArithmeticError,
    EOFError,
    RuntimeError,
    NotImplementedError,
)


def load_torch_file(path: Path, *, only_tensors: bool = False) -> Any:
    """What a file of `torch.save` holds, its tensors memory-mapped where the file allows it.

    Objects of classes that torch does not know are `Inert`; with `only_tensors` they are refused.
    Raises FileProblem.
    """
    require_file(path, "the tensors", most_bytes=1 << 50)
    try:
        with path.open("rb") as file:
            head = file.read(len(SIGNATURE))
    except OSError as error:
        raise FileProblem(f"cannot read the tensors ({describe_os_error(error)})", path) from error
    if head != SIGNATURE and head[:1] != PICKLE_SIGNATURE:
        raise FileProblem("this is not a PyTorch file, or it is cut short or damaged", path)
    # by its name
    is_mapped = head == SIGNATURE and is_utf8_encodable(str(path)) and path.suffix != ".safetensors"
    if not is_mapped:
        require_budget(path.stat().st_size, "the tensors", path)
    _require_short_description(path)
    import torch

    find_unknown_names: Any = torch.serialization.get_unsafe_globals_in_checkpoint
    try:
        with path.open("rb") as file:
            others = [] if only_tensors or head != SIGNATURE else find_unknown_names(file)
            if len(others) > _MAX_CLASSES:
                raise FileProblem("the file names too many classes; save the tensors alone", path)
            file.seek(0)
            kinds: list[Any] = [
                (_InertDict if name.lower().endswith("dict") else Inert, name) for name in others
            ]
            with torch.serialization.safe_globals(kinds):
                source = path if is_mapped else file
                return torch.load(source, map_location="cpu", weights_only=True, mmap=is_mapped)
    except FileProblem:
        raise
    except Exception as error:  # torch raises many unrelated classes for damaged files
        if "weights_only" in str(error) or "Unsupported" in str(error):
            raise FileProblem(
                "the file holds more than tensors and loading it could run code; save the tensors "
                "alone, such as a "
                "network's state_dict",
                path,
            ) from error
        raise FileProblem(
            "this is not a PyTorch file, or it is cut short or damaged", path
        ) from error


class Inert:
    """An object of a class that torch does not know; it does nothing."""

    def __init__(self, *_args: Any, **_named: Any) -> None:
        pass

    def __setstate__(self, state: object) -> None:
        """Ignore the attributes that the file sets."""


class _InertDict:
    """A mapping of a class that torch does not know becomes a plain one."""

    def __new__(cls, *_args: Any) -> Any:
        return {}


def require_checksums(path: Path) -> None:
    """Raise FileProblem where the checksum of a member of an archive does not fit.

    Torch does not compare them.
    """
    # torch says what is no archive
    with contextlib.suppress(*ZIP_ERRORS), zipfile.ZipFile(path) as archive:
        if archive.testzip() is not None:
            raise FileProblem("a tensor is damaged: copy or download the file again", path)


def _require_short_description(path: Path) -> None:
    """Raise FileProblem where torch would take more than a moment, or more than a budget, to load a
    file's table.

    Whether the rest is in order is for torch to say.
    """
    with path.open("rb") as file:
        if file.read(len(SIGNATURE)) == SIGNATURE:
            with contextlib.suppress(*ZIP_ERRORS), zipfile.ZipFile(file) as archive:
                described = [
                    m.file_size for m in archive.infolist() if m.filename.endswith("data.pkl")
                ]
                if max(described, default=0) > _MAX_DESCRIPTION_BYTES:
                    raise FileProblem(_TOO_LONG, path)
                folded = [m for m in archive.infolist() if m.compress_type != zipfile.ZIP_STORED]
                require_budget(
                    sum(member.file_size for member in folded),
                    "the compressed tensors",
                    path,
                    most=1 << 27,
                )
            return
        file.seek(0)
        limited = _LimitedFile(file)
        with contextlib.suppress(Exception):  # a pickle may fail in any way
            for _ in range(4):
                _InertUnpickler(limited).load()
        if limited.is_beyond:
            raise FileProblem(_TOO_LONG, path)


_TOO_LONG = (
    "the file's description of its tensors is too long: it is damaged; save the tensors alone"
)


class _LimitedFile:
    """A file of which a description is read, up to the size that one may have."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._left = _MAX_DESCRIPTION_BYTES

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


# Python's: that in C makes a table as long as any number that is stated
_Unpickler: Any = vars(pickle)["_Unpickler"]


class _InertUnpickler(_Unpickler):
    """Builds plain values and `Inert` objects; imports and calls nothing that the file names."""

    def find_class(self, _module: str, _name: str, /) -> Any:
        """A class without effect, whatever is named."""
        return Inert

    def persistent_load(self, _pid: Any, /) -> None:
        """Nothing in place of the numbers of a tensor."""
