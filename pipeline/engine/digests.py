"""Content digests: equal values have equal digests, whoever made them and whenever.

Arrays go through XXH3-128, microseconds a frame, so that everything can be hashed and nothing has to be guessed.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import xxhash
from numpy.typing import NDArray


def digest(value: object) -> str:
    """Hexadecimal digest of plain values, arrays, paths (their name), tuples, mappings and dataclasses of those.

    Raises TypeError for anything else: a stage that reads a value without a digest could not be cached honestly.
    """
    state = xxhash.xxh3_128()
    _feed(state, value)
    return state.hexdigest()


class Known:
    """Digests remembered by identity: sensors, meshes and results of an untouched sensor stay the same for hours.

    The values are held, so that no other can take their identity; the longest unused goes first. Only for values that
    nobody changes. Safe to share between threads.
    """

    def __init__(self, most: int = 32) -> None:
        self._most = most
        self._kept: OrderedDict[int, tuple[object, str]] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """How many digests are remembered."""
        return len(self._kept)

    def digest(self, value: object) -> str:
        """The same as `digest(value)`, worked out once."""
        with self._lock:
            known = self._kept.get(id(value))
            if known is not None:
                self._kept.move_to_end(id(value))
                return known[1]
        made = digest(value)
        with self._lock:
            self._kept[id(value)] = (value, made)
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return made


def size_bytes(value: object) -> int:
    """How much memory the arrays of a value take."""
    if isinstance(value, np.ndarray):
        return int(cast("NDArray[Any]", value).nbytes)
    if isinstance(value, (tuple, list)):
        return sum([size_bytes(v) for v in cast("tuple[object, ...]", value)])
    names = _field_names(type(value))
    return 16 if names is None else 64 + sum([size_bytes(getattr(value, name)) for name in names])


@lru_cache(maxsize=256)
def _field_names(kind: type) -> tuple[str, ...] | None:
    """The fields of a dataclass; None for any other type."""
    return tuple(f.name for f in fields(kind)) if is_dataclass(kind) else None


def _feed(state: xxhash.xxh3_128, value: object) -> None:
    if isinstance(value, np.ndarray):
        array = cast("NDArray[Any]", value)
        state.update(f"a{array.dtype.str}{array.shape}".encode())
        state.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    elif value is None or isinstance(value, (bool, int, float, str, Path)):
        # repr of a float is exact; the type's name keeps 1, 1.0, True and "1" apart.
        state.update(f"{type(value).__name__}:{value!r};".encode())
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
        names = _field_names(type(value))
        if names is None:
            raise TypeError(f"a {type(value).__name__} has no content digest")
        state.update(f"c{type(value).__qualname__}(".encode())
        for name in names:
            _feed(state, getattr(value, name))
