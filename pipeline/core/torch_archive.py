"""PyTorch files, loaded by torch without running code that they name, and without filling the
memory.

`torch.load(weights_only=True)` refuses names that it does not know, such as callbacks of a training
checkpoint. Where the other contents do not matter, each becomes a class that does nothing. What
torch does not check is checked before: the length of the description, which a few bytes can unfold
to gigabytes, and the checksums of the numbers.
"""

import contextlib
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

from pipeline.core.errors import FileProblem, is_utf8_encodable
from pipeline.core.files import name_os_error, require_budget, require_file

SIGNATURE = b"PK\x03\x04"  # first bytes of an archive
PICKLE_SIGNATURE = b"\x80"  # a pickle's protocol mark: torch before 1.6 wrote several
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
    with name_os_error("cannot read the tensors", path), path.open("rb") as file:
        head = file.read(len(SIGNATURE))
    if head[:1] == PICKLE_SIGNATURE:
        raise FileProblem(
            "this file was saved by torch before 1.6 or without an archive; load it with torch and "
            "save its tensors again",
            path,
        )
    if head != SIGNATURE:
        raise FileProblem("this is not a PyTorch file, or it is cut short or damaged", path)
    is_mapped = is_utf8_encodable(str(path)) and path.suffix != ".safetensors"  # by its name
    if not is_mapped:
        require_budget(path.stat().st_size, "the tensors", path)
    _require_short_description(path)
    import torch

    find_unknown_names: Any = torch.serialization.get_unsafe_globals_in_checkpoint
    try:
        with path.open("rb") as file:
            others = [] if only_tensors else find_unknown_names(file)
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
    with contextlib.suppress(*ZIP_ERRORS), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        described = [m.file_size for m in members if m.filename.endswith("data.pkl")]
        if max(described, default=0) > _MAX_DESCRIPTION_BYTES:
            raise FileProblem(
                "the file's description of its tensors is too long: it is damaged; save the "
                "tensors alone",
                path,
            )
        require_budget(
            sum(m.file_size for m in members if m.compress_type != zipfile.ZIP_STORED),
            "the compressed tensors",
            path,
            most=1 << 27,
        )
