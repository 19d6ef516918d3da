"""Array types; arrays that leave a function are read-only."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.base.lazy_import import defer_import

defer_import("numpy.f2py", "numpy.testing")  # scipy touches all of numpy, including a Fortran compiler's front end

Image = NDArray[np.uint8]  # (rows, cols, 3) RGB
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int32]  # -1 = none

A = TypeVar("A", bound=NDArray[Any])


def freeze(array: A) -> A:
    """Make the array read-only and return it."""
    array.flags.writeable = False
    return array


def ensure_float(array: NDArray[Any]) -> NDArray[Any]:
    """Return float64 and float32 arrays unchanged, others as float32, which holds micrometres."""
    return array if array.dtype.char in "fd" else array.astype(np.float32)
