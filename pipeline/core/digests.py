"""Content digests: equal values have equal digests, across processes and time.

Arrays use XXH3-128, microseconds per frame.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import xxhash
from numpy.typing import NDArray

from pipeline.core.memo import Memo, field_names

UNDIGESTED: Mapping[str, bool] = MappingProxyType({"digest": False})
"""Metadata of a dataclass field that the digest leaves out, such as steps kept for display."""

_MIN_CACHED_BYTES = 4096  # bytes; a smaller array is hashed faster than looked up
# per digest cache: values used for each frame, not the frames of a recording
_MAX_BYTES = 4 * 1024 * 1024
_arrays: Memo[int, tuple[NDArray[Any], bytes]] = Memo(256, most_bytes=_MAX_BYTES)


def compute_digest(value: object) -> str:
    """Return the hexadecimal digest of plain values, bytes, arrays, paths, tuples, mappings or
    dataclasses.

    Raises TypeError for anything else: a stage that reads a value without a digest cannot be
    cached.
    """
    state = xxhash.xxh3_128()
    _feed(state, value)
    return state.hexdigest()


class DigestCache:
    """Digests cached by identity, for values that stay the same for long, such as sensors and
    meshes.

    Only immutable values are cached; they are held, so that their identity is not reused. The least
    recently used goes first. Safe to share between threads.
    """

    def __init__(self, most: int = 32) -> None:
        self._kept: Memo[int, tuple[object, str]] = Memo(most, most_bytes=_MAX_BYTES)

    def __len__(self) -> int:
        """Return the number of cached digests."""
        return len(self._kept)

    def compute_digest(self, value: object) -> str:
        """Return `compute_digest(value)`, computed once."""
        known = self._kept.get(id(value))
        if known is not None:
            return known[1]
        made = compute_digest(value)
        if is_frozen(value):
            self._kept.put(id(value), (value, made))
        return made


compute_cached_digest = DigestCache(most=128).compute_digest  # for keys of all memos


def is_frozen(value: object) -> bool:
    """Return whether a value is immutable: no array in it, nor one that it is a view of, is
    writable.
    """
    if isinstance(value, np.ndarray):
        array = cast("NDArray[Any]", value)
        base: object = array.base
        return not array.flags.writeable and (
            base is None or isinstance(base, bytes) or is_frozen(base)
        )
    if isinstance(value, tuple):
        return all(is_frozen(v) for v in cast("tuple[object, ...]", value))
    names = field_names(type(value))
    if names is None:
        return value is None or isinstance(value, (bool, int, float, str, bytes, Path))
    frozen = cast("Any", value).__dataclass_params__.frozen
    return bool(frozen) and all(is_frozen(getattr(value, name)) for name in names)


def _digest_array(array: NDArray[Any]) -> bytes:
    """Digest the array's bytes, cached by identity where it is immutable: values share arrays."""
    is_large = array.nbytes >= _MIN_CACHED_BYTES
    known = _arrays.get(id(array)) if is_large else None
    if known is not None:
        return known[1]
    made = xxhash.xxh3_128_digest(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    if is_large and is_frozen(array):
        _arrays.put(id(array), (array, made))
    return made


def _feed(state: xxhash.xxh3_128, value: object) -> None:
    if isinstance(value, np.ndarray):
        array = cast("NDArray[Any]", value)
        if isinstance(array, np.ma.MaskedArray):  # masked values are no content, the mask is
            _feed(state, ("masked", np.ma.getmaskarray(array)))
            array = array.filled(0)
        state.update(f"a{array.dtype.str}{array.shape}".encode())
        state.update(_digest_array(array))
    elif value is None or isinstance(value, (bool, int, float, str, Path)):
        # repr of a float is exact; the type's name keeps 1, 1.0, True and "1" apart.
        state.update(f"{type(value).__name__}:{value!r};".encode())
    elif isinstance(value, slice):
        _feed(state, ("slice", value.start, value.stop, value.step))
    elif isinstance(value, bytes):
        state.update(f"b{len(value)}:".encode() + value)
    elif isinstance(value, (tuple, list)):
        items = cast("tuple[object, ...]", value)
        state.update(f"t{len(items)}(".encode())
        for item in items:
            _feed(state, item)
    elif isinstance(value, dict):
        pairs = cast("dict[str, object]", value)
        state.update(f"d{len(pairs)}(".encode())
        for key in sorted(pairs):
            _feed(state, (key, pairs[key]))
    else:
        names = field_names(type(value), digested=True)
        if names is None:
            raise TypeError(f"a {type(value).__name__} has no content digest")
        state.update(f"c{type(value).__qualname__}(".encode())
        for name in names:
            _feed(state, getattr(value, name))


_MAX_WHOLE_BYTES = 64 << 20  # larger files: size and some blocks
_BLOCK_BYTES = 256 << 10
_BLOCKS = 64
_MAX_ENTRIES = 20_000  # of a folder


def compute_fingerprint(path: Path) -> str:
    """Return XXH3-128 in hexadecimal of a file's bytes, or of the names and sizes in a folder.

    "" if unreadable.

    Beyond 64 MiB the size and 64 evenly spread blocks count: fast for recordings of many gigabytes,
    but a change between two blocks is missed.
    """
    state = xxhash.xxh3_128()
    try:
        if path.is_dir():
            for entry in _list_entries(path):
                state.update(entry)
            return state.hexdigest()
        if not path.is_file():  # opening a pipe would wait for ever
            return ""
        size = path.stat().st_size
        state.update(str(size).encode())
        with path.open("rb") as file:
            if size <= _MAX_WHOLE_BYTES:
                state.update(file.read())
            else:
                for block in range(_BLOCKS):
                    file.seek(block * (size - _BLOCK_BYTES) // (_BLOCKS - 1))
                    state.update(file.read(_BLOCK_BYTES))
    except (OSError, ValueError):
        return ""
    return state.hexdigest()


def _list_entries(folder: Path) -> list[bytes]:
    found: list[bytes] = []
    for where, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted(files):
            size = (Path(where) / name).stat().st_size
            found.append(
                f"{os.path.relpath(where, folder)}/{name} {size}\n".encode(errors="surrogateescape")
            )
        if len(found) >= _MAX_ENTRIES:
            break
    return found
