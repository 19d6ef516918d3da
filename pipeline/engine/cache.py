"""What stages have already worked out, bounded in bytes; the longest unused result goes first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass

DEFAULT_MAX_BYTES = 512 * 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One stage's output under its key."""

    output: object
    digest: str
    n_bytes: int
    was_shortcut: bool  # found without running the stage proper


class Cache:
    """Key -> Entry, safe to share between threads."""

    def __init__(self, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self.max_bytes = max_bytes
        self._entries: OrderedDict[str, Entry] = OrderedDict()
        self._n_bytes = 0
        self._lock = threading.Lock()

    @property
    def n_bytes(self) -> int:
        """How much is held now; never above `max_bytes`."""
        return self._n_bytes

    def __len__(self) -> int:
        """How many outputs are held."""
        return len(self._entries)

    def get(self, key: str) -> Entry | None:
        """The entry of `key`, from now on the most recently used one."""
        with self._lock:
            entry = self._entries.get(key)
            if entry is not None:
                self._entries.move_to_end(key)
            return entry

    def put(self, key: str, entry: Entry) -> None:
        """Keep `entry`, forgetting old ones; an entry that alone is too large is not kept."""
        with self._lock:
            old = self._entries.pop(key, None)
            self._n_bytes -= old.n_bytes if old else 0
            if entry.n_bytes > self.max_bytes:
                return
            self._entries[key] = entry
            self._n_bytes += entry.n_bytes
            while self._n_bytes > self.max_bytes:
                _, dropped = self._entries.popitem(last=False)
                self._n_bytes -= dropped.n_bytes

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._entries.clear()
            self._n_bytes = 0
