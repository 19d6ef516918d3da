"""Values that processes hand to each other in shared memory: arrays are copied into it and out of
it, and do not go through a pipe.
"""

import pickle
from dataclasses import dataclass
from itertools import accumulate, pairwise
from multiprocessing.shared_memory import SharedMemory
from typing import Any

_PROTOCOL = 5  # of pickle, which leaves the memory of arrays out


@dataclass(frozen=True, slots=True)
class Parcel:
    """A value without its arrays, and where they lie in the block."""

    pickled: bytes
    bounds: tuple[int, ...]  # of the arrays, one after the other, in bytes


class SharedBlock:
    """A block of shared memory for one value at a time: `n_bytes` of a new one, or the one of
    another process by its `name`.

    Memory that no value has reached takes no space.
    """

    def __init__(self, n_bytes: int = 0, *, name: str = "") -> None:
        self._is_own = not name
        self._memory = SharedMemory(name=name or None, create=self._is_own, size=n_bytes)
        buffer = self._memory.buf
        assert buffer is not None
        self._buffer = buffer

    @property
    def name(self) -> str:
        """Name by which another process opens it."""
        return self._memory.name

    def put(self, value: object) -> Parcel:
        """Replace the content by a value; one that is too large is pickled whole."""
        arrays: list[pickle.PickleBuffer] = []
        pickled = pickle.dumps(value, protocol=_PROTOCOL, buffer_callback=arrays.append)
        views = [array.raw() for array in arrays]
        bounds = tuple(accumulate((view.nbytes for view in views), initial=0))
        if bounds[-1] > self._buffer.nbytes:
            return Parcel(pickle.dumps(value, protocol=_PROTOCOL), (0,))
        for view, (start, end) in zip(views, pairwise(bounds), strict=True):
            self._buffer[start:end] = view
        return Parcel(pickled, bounds)

    def take(self, parcel: Parcel) -> Any:
        """Return a copy of the value, whose arrays are read-only."""
        parts = (bytes(self._buffer[start:end]) for start, end in pairwise(parcel.bounds))
        return pickle.loads(parcel.pickled, buffers=parts)  # noqa: S301 - of our own processes

    def close(self) -> None:
        """Give the memory back; an own block is gone for all."""
        self._memory.close()
        if self._is_own:
            self._memory.unlink()
