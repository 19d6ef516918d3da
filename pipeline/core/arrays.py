"""Array types, and medians without numpy's overhead for a call.

Arrays that leave a function are read-only.
"""

import importlib.util
import sys
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray


def defer_import(*names: str) -> None:
    """Load submodules of loaded packages at their first attribute access.

    Modules already loaded are unchanged.
    """
    for name in names:
        package, _, last = name.rpartition(".")
        spec = (
            None
            if name in sys.modules or package not in sys.modules
            else importlib.util.find_spec(name)
        )
        if spec is None or spec.loader is None:
            continue
        spec.loader = importlib.util.LazyLoader(spec.loader)
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        setattr(sys.modules[package], last, module)


# scipy touches all of numpy, including a Fortran compiler's front end
defer_import("numpy.f2py", "numpy.testing")

Image = NDArray[np.uint8]  # (rows, cols, 3) RGB
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Reals = NDArray[np.floating]  # float32 or float64
Stored = NDArray[np.generic]  # numbers of any type, as a file holds them
Mask = NDArray[np.bool_]
Indices = NDArray[np.int32]  # -1 = none

A = TypeVar("A", bound=NDArray[Any])


def freeze(array: A) -> A:
    """Make the array read-only and return it."""
    array.flags.writeable = False
    return array


def describe_size(shape: tuple[int, ...]) -> str:
    """Return the size of an image of this shape (rows, cols, ...) as `cols x rows px`."""
    return f"{shape[1]} x {shape[0]} px"


def ensure_float(array: NDArray[Any]) -> NDArray[Any]:
    """Return float64 and float32 arrays unchanged, others as float32, which holds micrometres."""
    return array if array.dtype.char in "fd" else array.astype(np.float32)


def median(values: Floats, where: Mask | None = None) -> np.float32:
    """The median of an array, or of its values in a mask `where` of the same shape, which holds
    at least one.
    """
    return percentile(values, 50.0, where)


def percentile(values: Floats, percent: float, where: Mask | None = None) -> np.float32:
    """The percentile, interpolated linearly, of an array or of its values in a mask, which holds
    at least one.
    """
    flat = (
        np.asarray(values, np.float32).reshape(-1)
        if where is None
        else np.asarray(values, np.float32)[where]
    )
    whole, share = divmod((flat.size - 1) * percent / 100.0, 1.0)
    low = int(whole)
    high = min(int(whole) + 1, flat.size - 1)
    ordered = np.partition(flat, (low, high))
    return np.float32(ordered[low] + (np.float64(ordered[high]) - ordered[low]) * share)
