"""Work that a pool of processes does ahead, in the order of its tasks."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from typing import TypeVar

from pipeline.core.errors import NotConverged

_CHECK_S = 0.5  # between two looks for a request to stop
A = TypeVar("A")
T = TypeVar("T")


def map_ahead(
    pool: Executor | None,
    function: Callable[[A], T],
    arguments: Iterable[A],
    ahead: int,
    remedy: str,
    check: Callable[[], None] = lambda: None,
) -> Generator[T, None, None]:
    """Results in order; a pool makes up to `ahead` of them before they are asked for.

    `check` is called while they are made and may raise. Raises NotConverged with the `remedy` where
    a process dies.
    """
    if pool is None:
        for argument in arguments:
            check()
            yield function(argument)
        return
    left = iter(arguments)
    waiting: deque[Future[T]] = deque()
    try:
        while True:
            for argument in islice(left, ahead - len(waiting)):
                waiting.append(pool.submit(function, argument))
            if not waiting:
                return
            future = waiting.popleft()
            while not wait((future,), timeout=_CHECK_S).done:
                check()
            yield future.result()
    except BrokenProcessPool as error:
        raise NotConverged(
            f"a worker process died, perhaps out of memory; run again with {remedy}"
        ) from error
    finally:
        for future in waiting:
            future.cancel()
