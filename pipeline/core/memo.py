"""A bounded, thread-safe cache that computes each value once.

Keys are plain values, or digests of values with arrays
(`pipeline.core.digests.compute_cached_digest`).
"""

import functools
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Container, Hashable
from dataclasses import fields, is_dataclass
from typing import Any, Generic, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.frozen import frozen

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")
P = ParamSpec("P")

DEFAULT_MAX_BYTES = 512 * 1024 * 1024  # of the stages' results
MOST_BYTES = 64 * 1024 * 1024  # of one memo: two dozen values of the size of an image


class Memo(Generic[K, V]):
    """Key -> value; the least recently used goes first, and a value that exceeds the limit alone
    is not kept.
    """

    def __init__(
        self,
        most: float = math.inf,
        *,
        most_bytes: int = MOST_BYTES,
        weigh: Callable[[V], int] | None = None,
    ) -> None:
        """Hold at most `most` values of `most_bytes` in all.

        `weigh` None counts the bytes of their arrays.
        """
        self.most = most
        self.most_bytes = most_bytes
        self._weigh = measure_bytes if weigh is None else weigh
        self._values: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._making: dict[K, threading.Event] = {}
        self._n_bytes = 0
        self._lock = threading.Lock()

    @property
    def n_bytes(self) -> int:
        """Bytes held; at most `most_bytes`."""
        return self._n_bytes

    def __len__(self) -> int:
        """Return the number of values held."""
        return len(self._values)

    def get(self, key: K) -> V | None:
        """Return the value of `key` and mark it as used; None if there is none."""
        with self._lock:
            found = self._values.get(key)
            if found is None:
                return None
            self._values.move_to_end(key)
            return found[0]

    def put(self, key: K, answer: V) -> None:
        """Store `answer`; the least recently used values go."""
        weight = self._weigh(answer)
        with self._lock:
            self._n_bytes -= self._values.pop(key, (None, 0))[1]
            if weight > self.most_bytes:
                return
            self._values[key] = (answer, weight)
            self._n_bytes += weight
            while self._n_bytes > self.most_bytes or len(self._values) > self.most:
                self._n_bytes -= self._values.popitem(last=False)[1][1]

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of `key`, made by `make` if missing.

        `make` must not ask for the same key nor return None.

        Other threads wait for the one that makes it; if that one fails, the next one makes it.
        """
        while True:
            answer = self.get(key)
            if answer is not None:
                return answer
            with self._lock:
                other_thread = self._making.get(key)
                if other_thread is None:
                    self._making[key] = threading.Event()
                    break
            other_thread.wait()
        try:
            answer = self.get(key)  # another thread may have stored it meanwhile
            if answer is None:
                answer = make()
                self.put(key, answer)
            return answer
        finally:
            with self._lock:
                self._making.pop(key).set()

    def keep_only(self, keys: Container[K]) -> None:
        """Drop all other keys."""
        with self._lock:
            for key in [key for key in self._values if key not in keys]:
                self._n_bytes -= self._values.pop(key)[1]

    def clear(self) -> None:
        """Drop all values."""
        with self._lock:
            self._values.clear()
            self._n_bytes = 0


def memoise(
    most: int, *, most_bytes: int = MOST_BYTES
) -> Callable[[Callable[P, V]], Callable[P, V]]:
    """Decorate a function of hashable arguments to keep its last results in a `Memo`, its
    attribute `memo`.
    """

    def wrap(function: Callable[P, V]) -> Callable[P, V]:
        memo: Memo[Any, V] = Memo(most, most_bytes=most_bytes)

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> V:
            return memo.get_or_make((args, *kwargs.items()), lambda: function(*args, **kwargs))

        cast("Any", call).memo = memo
        return call

    return wrap


def measure_bytes(value: object, besides: object = None) -> int:
    """Return the bytes of a value's arrays, each counted once.

    Arrays that are also in `besides` are left out.
    """
    counted: set[int] = set()
    _weigh(besides, counted)
    return _weigh(value, counted)


def _weigh(value: object, counted: set[int]) -> int:
    if isinstance(value, np.ndarray):
        if id(value) in counted:  # pyright: ignore[reportUnknownArgumentType]
            return 0
        counted.add(id(value))  # pyright: ignore[reportUnknownArgumentType]
        return int(cast("NDArray[Any]", value).nbytes)
    if isinstance(value, (tuple, list)):
        return sum([_weigh(v, counted) for v in cast("tuple[object, ...]", value)])
    names = field_names(type(value))
    if names is None:
        return 16
    found = (
        vars(value).values()
        if hasattr(value, "__dict__")
        else (getattr(value, name) for name in names)
    )
    # of a class without slots, cached properties too
    return 64 + sum([_weigh(one, counted) for one in found])


@functools.lru_cache(maxsize=256)
def field_names(kind: type, *, digested: bool = False) -> tuple[str, ...] | None:
    """Return the field names of a dataclass, or those that its digest holds; None for any other
    type.
    """
    if not is_dataclass(kind):
        return None
    return tuple(f.name for f in fields(kind) if not digested or f.metadata.get("digest", True))


@frozen
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
