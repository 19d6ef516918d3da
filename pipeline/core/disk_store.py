"""Cache on disk for slow results of few inputs, in the user's cache folder.

A file is named by the digest of its inputs and of the code that made it. Damaged files are made
again; without a readable or writable folder everything works uncached.
"""

import contextlib
from collections.abc import Callable
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import freeze
from pipeline.core.digests import compute_digest
from pipeline.core.errors import FileProblem
from pipeline.core.files import open_atomic, read_cached_arrays
from pipeline.core.user_folders import find_user_folder

_MAX_FILES = 40  # per folder, unless asked; a distance grid takes 16 MB

T = TypeVar("T")


def load_or_make(
    kind: type[T],
    made_of: object,
    code: tuple[str, ...],
    make: Callable[[], T],
    folder: Path | str,
    most_files: int = _MAX_FILES,
) -> T:
    """Read the value that `make` makes of `made_of` from disk, or make and write it.

    `code` names the modules that it depends on; a package stands for its own modules. `kind` is a
    flat dataclass of arrays, numbers and tuples of words; a relative `folder` is within the user's
    cache, and keeps the newest `most_files`.
    """
    key, path = _find_file(made_of, code, folder)
    value = _read(kind, path, key)
    if value is None:
        value = make()
        _write(value, path, key, most_files)
    return value


def load_stored(
    kind: type[T], made_of: object, code: tuple[str, ...], folder: Path | str
) -> T | None:
    """Read what `load_or_make` has written; None where it is not there."""
    key, path = _find_file(made_of, code, folder)
    return _read(kind, path, key)


def _find_file(made_of: object, code: tuple[str, ...], folder: Path | str) -> tuple[str, Path]:
    key = compute_digest((_digest_source(code), made_of))
    return key, cache_folder() / folder / f"{key}.npz"


def cache_folder() -> Path:
    """Return the user's cache folder of this program."""
    return find_user_folder("cache")


def _digest_source(code: tuple[str, ...]) -> str:
    """Digest the source of modules, so that a changed line makes other files."""
    return compute_digest([file.read_text("utf-8") for name in code for file in _files(name)])


def _files(name: str) -> list[Path]:
    """Return the files of a module, or of a package's own modules."""
    spec = find_spec(name)
    if spec is None or not spec.origin:
        return []
    return (
        sorted(Path(spec.origin).parent.glob("*.py"))
        if spec.submodule_search_locations
        else [Path(spec.origin)]
    )


def _read(kind: type[T], path: Path, key: str) -> T | None:
    found = read_cached_arrays(path)
    names = {f.name for f in fields(cast("Any", kind))}
    if found is None or str(found.pop("key", "")) != key or set(found) != names:
        return None
    return kind(**{name: _to_field_value(array) for name, array in found.items()})


def _to_field_value(array: NDArray[Any]) -> object:
    if array.ndim == 0:
        return array.item()
    return tuple(str(word) for word in array) if array.dtype.kind == "U" else freeze(array)


def _write(value: object, path: Path, key: str, most_files: int) -> None:
    arrays: dict[str, Any] = {
        f.name: np.asarray(getattr(value, f.name)) for f in fields(cast("Any", value))
    }
    with contextlib.suppress(FileProblem, OSError):
        with open_atomic(path, "a file of the cache", None) as file:
            np.savez(file, key=np.array(key), **arrays)
        newest_last = sorted(path.parent.glob("*.npz"), key=lambda file: file.stat().st_mtime)
        for old in newest_last[:-most_files]:
            old.unlink(missing_ok=True)
