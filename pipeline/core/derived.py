"""The cache of derived values: what follows from a description alone, such as the reference image
of a sensor.

One cache for all of them, bounded in bytes, whose keys are functions and contents of arguments.
What follows from a frame or from parameters belongs to the graph, whose own cache counts it.
"""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from pipeline.core.digests import compute_cached_digest
from pipeline.core.memo import Memo

P = ParamSpec("P")
V = TypeVar("V")

_MAX_BYTES = 128 * 1024 * 1024  # tables, images and responses of a dozen sensors
DERIVED: Memo[tuple[object, ...], tuple[Any]] = Memo(most_bytes=_MAX_BYTES)


def derive_once(function: Callable[P, V]) -> Callable[P, V]:
    """Decorate a function without side effects: equal arguments give the object that was computed
    first.

    Arguments are hashable, or have a content digest; the value must not be written to.
    """

    @functools.wraps(function)
    def derive(*args: P.args, **kwargs: P.kwargs) -> V:
        key = (
            function,
            *map(_make_key, args),
            *((name, _make_key(value)) for name, value in kwargs.items()),
        )
        return DERIVED.get_or_make(key, lambda: (function(*args, **kwargs),))[0]

    return derive


def _make_key(value: object) -> object:
    try:
        hash(value)
    except TypeError:  # it holds arrays
        return compute_cached_digest(value)
    return value
