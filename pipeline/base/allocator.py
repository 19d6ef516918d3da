"""What the C library's allocator keeps of memory that is free; where there is no glibc, nothing is done."""

from __future__ import annotations

import ctypes
import sys
from functools import lru_cache

_ARENA_MAX = -8  # glibc's number of that setting
_MOST_ARENAS = 2


def limit_arenas() -> bool:
    """Let threads share two heaps: each of twenty would keep what its largest moment took. Whether that was done."""
    library = _glibc()
    return library is not None and bool(library.mallopt(_ARENA_MAX, _MOST_ARENAS))


def release_free_memory() -> None:
    """Return free memory to the system: where a recording is closed, a hundred megabytes may lie about in pieces."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


@lru_cache(maxsize=1)
def _glibc() -> ctypes.CDLL | None:
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "malloc_trim") and hasattr(library, "mallopt") else None
