"""Simulated samples by name: held in memory, and stored in a folder where one is given.

A simulation takes a tenth of a second and training draws each sample many times. A sample is a frozen dataclass of
arrays and texts. float32 fields are rounded to float16 when a sample is made, so that it equals the stored one.
"""

import io
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.files import open_atomic, read_cached_arrays
from pipeline.base.memo import Memo

T = TypeVar("T")


class SampleCache(Generic[T]):
    """Samples of one dataclass, up to `max_bytes` in the memory of a process."""

    def __init__(self, kind: type[T], *, exact: tuple[str, ...] = (), max_bytes: int = 1 << 30) -> None:
        """Fields named in `exact` keep float32."""
        self._kind, self._exact = kind, exact
        self._memory: Memo[str, T] = Memo(most_bytes=max_bytes)

    def get(self, name: str, folder: str, make: Callable[[], T], **unstored: Any) -> T:
        """Sample `name`: from memory, from `folder`/`name`.npz, or made. An empty `folder` stores nothing.

        `unstored` fields are cheap to compute and not written.
        """
        return self._memory.get_or_make(name, lambda: self._load_or_make(name, folder, make, unstored))

    def clear(self) -> None:
        """Free the memory; files stay."""
        self._memory.clear()

    def _load_or_make(self, name: str, folder: str, make: Callable[[], T], unstored: dict[str, Any]) -> T:
        path = Path(folder) / f"{name}.npz"
        stored = self._load(path, unstored) if folder else None
        if stored is not None:
            return stored
        sample: Any = make()
        rounded = {
            key: freeze(array.astype(np.float16).astype(np.float32))
            for key, array in _list_arrays(sample).items()
            if array.dtype == np.float32 and key not in self._exact
        }
        sample = replace(sample, **rounded)
        if folder:
            self._save(path, sample, unstored)
        return sample

    def _save(self, path: Path, sample: T, unstored: dict[str, Any]) -> None:
        arrays = {key: a for key, a in _list_arrays(sample).items() if key not in unstored}
        content = io.BytesIO()
        stored: dict[str, Any] = {
            key: a.astype(np.float16) if a.dtype == np.float32 and key not in self._exact else a
            for key, a in arrays.items()
        }
        np.savez(content, **stored)
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_atomic(path, "a training sample") as file:
            file.write(content.getbuffer())

    def _load(self, path: Path, unstored: dict[str, Any]) -> T | None:
        """The stored sample; None where the file is missing, cut short or of other fields."""
        arrays = read_cached_arrays(path)
        if arrays is None or set(arrays) | set(unstored) != {f.name for f in fields(cast("Any", self._kind))}:
            return None
        values: dict[str, Any] = {
            key: str(a) if a.dtype.kind == "U" else freeze(a.astype(np.float32) if a.dtype == np.float16 else a)
            for key, a in arrays.items()
        }
        return self._kind(**values, **unstored)


def _list_arrays(sample: object) -> dict[str, np.ndarray[Any, Any]]:
    """Fields of a sample as arrays, texts included."""
    return {f.name: np.asarray(getattr(sample, f.name)) for f in fields(cast("Any", sample))}
