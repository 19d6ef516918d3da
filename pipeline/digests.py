"""Content digests: equal values have equal digests, whoever made them and whenever.

Arrays go through XXH3-128, microseconds a frame, so that everything can be hashed and nothing has to be guessed.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
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


def size_bytes(value: object) -> int:
    """How much memory the arrays of a value take."""
    if isinstance(value, np.ndarray):
        return int(cast("NDArray[Any]", value).nbytes)
    if isinstance(value, (tuple, list)):
        return sum(size_bytes(v) for v in cast("tuple[object, ...]", value))
    if is_dataclass(value):
        return 64 + sum(size_bytes(getattr(value, f.name)) for f in fields(value))
    return 16


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
    elif is_dataclass(value) and not isinstance(value, type):
        state.update(f"c{type(value).__qualname__}(".encode())
        for f in fields(value):
            _feed(state, getattr(value, f.name))
    else:
        raise TypeError(f"a {type(value).__name__} has no content digest")
