"""Decorators of numba kernels: compiled at the first call and cached on disk in
`compiling.kernel_folder()`.
"""
# pyright: basic

import contextlib
import os
import time
from functools import partial
from typing import Any

from numba import njit
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator
from numba.core.runtime.nrt import rtsys

from pipeline.core import compiling

_config: Any = config
_config.CACHE_DIR = os.fspath(compiling.kernel_folder())

FAST = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a NaN has to stay a NaN

# becomes part of its callers before they are compiled
inline_kernel: Any = partial(njit, inline="always")
# Called by kernels only: compiled into them, without an entry point for Python and without a cache
# file.
inner_kernel: Any = partial(
    njit, no_cfunc_wrapper=True, no_cpython_wrapper=True, error_model="numpy"
)  # type: ignore[reportCallIssue]


class _ModuleLocator(UserProvidedCacheLocator):
    """Names the folder of a kernel's files by its module, not by the path of the checkout."""

    def __init__(self, py_func, py_file):
        super().__init__(py_func, py_file)
        self._cache_path = os.fspath(compiling.kernel_folder() / py_func.__module__)


class _ModuleCacheImpl(CompileResultCacheImpl):
    _locator_classes = [_ModuleLocator]  # noqa: RUF012 - numba's own attribute


class _TolerantCache(FunctionCache):
    """Numba's cache of one kernel. A file that is damaged or cannot be written costs a
    compilation, not an error.
    """

    _impl_class = _ModuleCacheImpl

    def load_overload(self, sig, target_context):
        # Numba's own method first imports what only compiling needs: its numpy and scipy
        # implementations.
        rtsys.initialize(target_context)
        cached = self._load_tolerantly(sig, target_context)
        function = self._py_func
        if cached is None and compiling.compile_elsewhere(
            function.__module__, function.__qualname__, sig
        ):
            cached = self._load_tolerantly(sig, target_context)
        return cached

    def _load_tolerantly(self, sig, target_context):
        try:
            return self._load_overload(sig, target_context)
        except Exception:  # noqa: BLE001 - a damaged pickle may raise anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data):
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def kernel(**options: Any) -> Any:
    """Decorate a function that Python calls: compiled once and cached; `options` are numba's."""
    # Kernels are never called from C: without the entry point for C, compiling takes a seventh less
    # time.
    make: Any = njit
    compiled = make(cache=True, no_cfunc_wrapper=True, error_model="numpy", **options)

    def declare_kernel(function: Any) -> Any:
        dispatcher = compiled(function)
        dispatcher._cache = _TolerantCache(function)
        return dispatcher

    return declare_kernel


class _CompileListener(event.Listener):
    """Report compilations and measure their time.

    Kernels that a kernel compiles count as part of it.
    """

    _depth = 0  # changed under the compiler's lock
    _started_s = 0.0

    def on_start(self, event):  # noqa: ARG002
        if self._depth == 0:
            self._started_s = time.perf_counter()
        self._depth += 1
        compiling.begin_kernel()

    def on_end(self, event):  # noqa: ARG002
        self._depth -= 1
        if self._depth == 0:
            compiling.end_kernel(time.perf_counter() - self._started_s)


event.register("numba:compile", _CompileListener())
