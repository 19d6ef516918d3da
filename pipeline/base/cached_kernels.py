"""How kernels are declared, where numba keeps what it compiles of them, and what it tells `compiling`."""
# pyright: basic

import contextlib
import errno
import gc
import hashlib
import os
import pickle
from functools import partial
from pathlib import Path
from typing import Any

# While numba finds out types it words thousands of errors that nobody is shown; in colour they take longer.
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

from numba import njit
from numba.core import config, event
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime.nrt import rtsys

from pipeline.base import compiling

inlined: Any = partial(njit, inline="always")  # becomes part of what calls it before that is compiled

_DIGEST_BYTES = 32
FAST = {"contract", "arcp", "nsz", "reassoc"}  # not nnan: a NaN has to stay one


class _Whole(IndexDataCacheFile):
    """The files of one kernel, each behind a digest of numba's version and what follows: a wrong byte would be run.

    One that is damaged is as good as none, so that it is compiled and written again; where nothing can be written, the
    kernel is compiled all the same.
    """

    def save(self, key, data):
        with contextlib.suppress(OSError):
            super().save(key, data)

    def _load_index(self):
        try:
            stamp, overloads = self._load_data(self._index_name)
        except OSError:
            return {}
        return overloads if stamp == self._source_stamp else {}

    def _save_index(self, overloads):
        self._save_data(self._index_name, (self._source_stamp, overloads))

    def _load_data(self, name):
        told, content = (whole := Path(self._data_path(name)).read_bytes())[:_DIGEST_BYTES], whole[_DIGEST_BYTES:]
        if told != self._digest(content):
            raise OSError(errno.EIO, "damaged", self._data_path(name))
        return pickle.loads(content)  # noqa: S301 - as numba does; it is what this user's own process wrote

    def _save_data(self, name, data):
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(self._digest(content) + content)

    def _digest(self, content):
        return hashlib.sha256(self._version.encode() + content).digest()


class _Kept(FunctionCache):
    def __init__(self, function):
        super().__init__(function)
        self._cache_file = _Whole(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    def load_overload(self, sig, target_context):
        """Without what only compiling needs: numba's own numpy, and scipy's linear algebra behind it.

        Numba has them loaded each time a kernel is asked for; whoever compiles one asks for them anyway.
        """
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def kernel(**options: Any) -> Any:
    """Decorator of what is called from Python, compiled once and kept; `options` are numba's."""
    # No kernel is called from C: without the entry for it, compiling takes a seventh less.
    compiled: Any = njit(cache=True, no_cfunc_wrapper=True, error_model="numpy", **options)  # type: ignore[reportCallIssue]

    def declare_kernel(function: Any) -> Any:
        made = compiled(function)
        made._cache = _Kept(function)
        return made

    return declare_kernel


# What only kernels call is compiled into them, and kept with them: no entry from Python either, and no file of its own.
inner: Any = partial(njit, no_cfunc_wrapper=True, no_cpython_wrapper=True, error_model="numpy")  # type: ignore[reportCallIssue]


class Place:
    """The file of one kernel, as numba asks for it, a "cache locator".

    Numba alone would load a kernel that calls one of another module as it was before that module changed.
    """

    def __init__(self, function, module):
        self._line, self._module = function.__code__.co_firstlineno, Path(module)

    @classmethod
    def from_function(cls, function, module):
        return cls(function, module) if function.__module__.startswith("pipeline.") else None

    def ensure_cache_path(self):
        Path(self.get_cache_path()).mkdir(parents=True, exist_ok=True)

    def get_cache_path(self):
        return str(compiling.kernel_folder(self._module))

    def get_source_stamp(self):
        return compiling.stamp(self._module)

    def get_disambiguator(self):
        return str(self._line)


class _Compiling(event.Listener):
    """Tells what is compiled, and has no garbage looked for meanwhile: little of what the compiler makes is any."""

    _depth = 0  # one kernel compiles another; changed under the compiler's lock, as is the other
    _collects = False

    def on_start(self, event):
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        function = event.data["dispatcher"].py_func
        compiling.begin_kernel(f"{function.__module__}.{function.__qualname__}")

    def on_end(self, event):  # noqa: ARG002
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


class _Asking(event.Listener):
    def on_start(self, event):  # noqa: ARG002
        compiling.enter_compiler()

    def on_end(self, event):  # noqa: ARG002
        compiling.leave_compiler()


# The others are numba's own, for whatever else is compiled.
os.environ.setdefault(
    "NUMBA_CACHE_LOCATOR_CLASSES", f"{__name__}.Place,UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator"
)
config.reload_config()
event.register("numba:compile", _Compiling())
event.register("numba:compiler_lock", _Asking())
