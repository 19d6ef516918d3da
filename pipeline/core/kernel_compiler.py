"""Compile kernels in a process of its own, which ends when nothing is left to compile.

A process that compiles keeps about 150 MB of the compiler for as long as it runs, and its other
threads wait meanwhile.
"""

import atexit
import contextlib
import importlib
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from typing import BinaryIO, cast

from pipeline.core import compiling

_IDLE_S = 10.0  # without a request, after which the process ends
_SERVE = "from pipeline.core.kernel_compiler import serve; serve()"
_STOP_S = 2.0
_ANSWER_S = 300.0  # in which a kernel is compiled, on the slowest machine
_POLL_S = 1.0  # between looks at a process that has not answered yet


def compile_in_own_process() -> None:
    """Make this process load kernels from the cache only: another process compiles those that
    are missing.
    """
    process = _CompilerProcess()
    atexit.register(process.stop)
    compiling.set_compiler(process.compile)


def serve() -> None:
    """Compile what standard input asks for.

    Ends with the process that asks, or when nothing is asked for a while.
    """
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no reply
    with contextlib.suppress(EOFError, OSError):
        while True:
            with _end_when_idle():
                # from the process that started this one
                module, name, signature = pickle.load(sys.stdin.buffer)  # noqa: S301
            try:
                getattr(importlib.import_module(module), name).compile(signature)
                reply = ""
            # whoever asks compiles it then, and reports the same
            except Exception as error:  # noqa: BLE001
                reply = f"{type(error).__name__}: {error}"
            pickle.dump(reply, replies)
            replies.flush()


@contextlib.contextmanager
def _end_when_idle() -> Generator[None]:
    timer = threading.Timer(_IDLE_S, os._exit, (0,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _wait_for_answer(process: subprocess.Popen[bytes]) -> bool:
    """Whether the process answers or ends.

    False where it is stopped, as by a debugger, or takes too long.
    """
    until_s = time.monotonic() + _ANSWER_S
    replies = cast("BinaryIO", process.stdout)
    while time.monotonic() < until_s:
        if select.select([replies], [], [], _POLL_S)[0]:
            return True
        if os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT):
            return False
    return False


class _CompilerProcess:
    """Starts the process when it is needed.

    Called by one thread at a time, under the compiler's lock.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def compile(self, module: str, name: str, signature: object) -> bool:
        """Return whether the kernel `name` of `module` was compiled for the types of its
        arguments.
        """
        request = pickle.dumps((module, name, signature))
        for _ in range(2):  # one that was idle may have ended just now
            with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):
                process = self._start()
                asked = cast("BinaryIO", process.stdin)
                replies = cast("BinaryIO", process.stdout)
                asked.write(request)
                asked.flush()
                if not _wait_for_answer(process):
                    break
                # from the process that this one started
                return pickle.load(replies) == ""  # noqa: S301
            self.stop()
        self.stop()
        return False

    def stop(self) -> None:
        """End the process, if there is one."""
        process = self._process
        self._process = None
        if process is not None:
            process.kill()
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):
                process.communicate(timeout=_STOP_S)

    def _start(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self.stop()
            environment = {
                **os.environ,
                "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            }
            # this very interpreter; -P: nothing from the folder that it runs in
            self._process = subprocess.Popen(  # noqa: S603
                [sys.executable, "-P", "-c", _SERVE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=environment,
            )
        return self._process
