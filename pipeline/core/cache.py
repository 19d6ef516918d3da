"""Stage results in memory, bounded in bytes; the least recently used goes first."""

from dataclasses import dataclass

from pipeline.core.memo import Memo

DEFAULT_MAX_BYTES = 512 * 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class CacheEntry:
    """One stage's output under its key."""

    output: object
    digest: str
    n_bytes: int
    skip_reason: str = ""  # why nothing had to be computed; "" = it was
    fallback: str = ""  # why another method gave the result; "" = it did not
    ends_chain: bool = False  # of a node: whether its output is that of the whole chain


class Cache(Memo[str, CacheEntry]):
    """Key -> CacheEntry, safe to share between threads."""

    def __init__(self, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        super().__init__(most_bytes=max_bytes, weigh=lambda entry: entry.n_bytes)
