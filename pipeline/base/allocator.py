"""Control how much free memory glibc's allocator keeps; without glibc nothing is done."""

import ctypes
import sys
from functools import lru_cache

_ARENA_MAX = -8  # glibc's M_ARENA_MAX
_MAX_ARENAS = 2


def limit_arenas() -> bool:
    """Limit threads to two shared heaps, as each keeps its peak; returns whether that was possible."""
    library = _glibc()
    return library is not None and bool(library.mallopt(_ARENA_MAX, _MAX_ARENAS))


def release_free_memory() -> None:
    """Return free memory to the system; after closing a recording a hundred megabytes may be fragmented."""
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


@lru_cache(maxsize=1)
def _glibc() -> ctypes.CDLL | None:
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "malloc_trim") and hasattr(library, "mallopt") else None
