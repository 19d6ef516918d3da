"""What has been worked out once and is kept for the next time: bounded, locked, and made once however many ask.

Keys are content: plain values, or the digest of what holds arrays (`pipeline.engine.digests.content`).
"""

from __future__ import annotations

import functools
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Container, Hashable
from dataclasses import fields, is_dataclass
from typing import Any, Generic, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")
P = ParamSpec("P")

MOST_BYTES = 64 * 1024 * 1024  # of one memo: two dozen answers of the size of a picture


class Memo(Generic[K, V]):
    """Key -> answer; the longest unused goes first, and one that alone is too large is not kept."""

    def __init__(
        self, most: float = math.inf, *, most_bytes: int = MOST_BYTES, weigh: Callable[[V], int] | None = None
    ) -> None:
        """Hold `most` answers that weigh `most_bytes` in all; `weigh` None counts the bytes of their arrays."""
        self.most, self.most_bytes = most, most_bytes
        self._weigh = measure_bytes if weigh is None else weigh
        self._kept: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._making: dict[K, threading.Event] = {}
        self._n_bytes = 0
        self._lock = threading.Lock()

    @property
    def n_bytes(self) -> int:
        """How much is held now; never above `most_bytes`."""
        return self._n_bytes

    def __len__(self) -> int:
        """How many answers are held."""
        return len(self._kept)

    def get(self, key: K) -> V | None:
        """The answer of `key`, from now on the most recently used one; None where there is none."""
        with self._lock:
            found = self._kept.get(key)
            if found is None:
                return None
            self._kept.move_to_end(key)
            return found[0]

    def put(self, key: K, answer: V) -> None:
        """Keep `answer`, forgetting old ones."""
        weight = self._weigh(answer)
        with self._lock:
            self._n_bytes -= self._kept.pop(key, (None, 0))[1]
            if weight > self.most_bytes:
                return
            self._kept[key] = (answer, weight)
            self._n_bytes += weight
            while self._n_bytes > self.most_bytes or len(self._kept) > self.most:
                self._n_bytes -= self._kept.popitem(last=False)[1][1]

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """The answer of `key`, kept or made by `make`, which must not ask for the same key; not None.

        Who asks while another thread makes it waits for that one; if that one fails, makes it itself.
        """
        while True:
            answer = self.get(key)
            if answer is not None:
                return answer
            with self._lock:
                made_elsewhere = self._making.get(key)
                if made_elsewhere is None:
                    self._making[key] = threading.Event()
                    break
            made_elsewhere.wait()
        try:
            answer = self.get(key)  # it may have come between the two looks
            if answer is None:
                answer = make()
                self.put(key, answer)
            return answer
        finally:
            with self._lock:
                self._making.pop(key).set()

    def keep_only(self, keys: Container[K]) -> None:
        """Forget all others."""
        with self._lock:
            for key in [key for key in self._kept if key not in keys]:
                self._n_bytes -= self._kept.pop(key)[1]

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._kept.clear()
            self._n_bytes = 0


def memoise(most: int, *, most_bytes: int = MOST_BYTES) -> Callable[[Callable[P, V]], Callable[P, V]]:
    """Decorator: a function of hashable arguments keeps its last answers in a `Memo`, which is its `memo`."""

    def wrap(function: Callable[P, V]) -> Callable[P, V]:
        memo: Memo[Any, V] = Memo(most, most_bytes=most_bytes)

        @functools.wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> V:
            return memo.get_or_make((args, *kwargs.items()), lambda: function(*args, **kwargs))

        cast("Any", asked).memo = memo
        return asked

    return wrap


def measure_bytes(value: object, besides: object = None) -> int:
    """How much memory the arrays of a value take, each counted once; those that are also in `besides` not at all."""
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
    return 16 if names is None else 64 + sum([_weigh(getattr(value, name), counted) for name in names])


@functools.lru_cache(maxsize=256)
def field_names(kind: type) -> tuple[str, ...] | None:
    """The fields of a dataclass; None for any other type."""
    return tuple(f.name for f in fields(kind)) if is_dataclass(kind) else None
