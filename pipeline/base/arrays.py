"""Array types, and the one habit they share: what leaves a function is not written to again."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.base.lazy_import import defer_import

defer_import("numpy.f2py", "numpy.testing")  # scipy asks numpy for all it has, a Fortran compiler's front among it

Image = NDArray[np.uint8]  # (rows, cols, 3) RGB
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int32]  # -1 = none

A = TypeVar("A", bound=NDArray[Any])


def freeze(array: A) -> A:
    """The same array, read-only from now on."""
    array.flags.writeable = False
    return array


def ensure_float(array: NDArray[Any]) -> NDArray[Any]:
    """The array in a type that lengths keep their micrometres in: float64 and float32 as they are, others widened."""
    return array if array.dtype.char in "fd" else array.astype(np.float32)
