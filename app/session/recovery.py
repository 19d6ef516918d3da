"""Sessions kept for the case that the program is ended from outside: one file a window, gone when it closes well."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from app.session.file_fingerprints import fingerprint_files
from app.session.state import SESSION_SUFFIX, Session, load_session, save_session
from pipeline.base.errors import TouchError
from pipeline.base.files import open_lock
from pipeline.translation.catalogue import BUILT_IN, Catalogue

_LOCK = ".lock"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverableSession:
    """What a window that was ended from outside left behind."""

    path: Path
    session: Session
    age_s: float


def get_recovery_folder() -> Path:
    """Where windows keep their sessions while they are open."""
    import platformdirs

    return Path(platformdirs.user_state_dir("tactoscope", appauthor=False)) / "recovery"


class RecoveryFile:
    """One window's session on disk; a lock that dies with the process tells others that it is in use."""

    def __init__(self, folder: Path) -> None:
        self._name = f"session-{os.getpid()}-{time.time_ns()}"
        self.path = folder / f"{self._name}{SESSION_SUFFIX}"
        self._folder = folder
        self._lock: IO[bytes] | None = None

    def write(self, session: Session) -> None:
        """Put `session` in the place of what was kept; raises FileProblem."""
        if self._lock is None:
            self._lock = open_lock(self._folder / f"{self._name}{_LOCK}")
        save_session(session, self.path, fingerprint_files(session))

    def remove(self) -> None:
        """The window closes well: there is nothing to recover."""
        for path in (self.path, self._folder / f"{self._name}{_LOCK}"):
            path.unlink(missing_ok=True)
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def find_recoverable_sessions(folder: Path, catalogue: Catalogue = BUILT_IN) -> tuple[RecoverableSession, ...]:
    """The sessions whose windows are gone, the newest first; those that cannot be read are left out."""
    found: list[RecoverableSession] = []
    for path in folder.glob(f"session-*{SESSION_SUFFIX}"):
        with contextlib.suppress(OSError, TouchError):
            if not _in_use(_lock_of(path)):
                age_s = time.time() - path.stat().st_mtime
                found.append(RecoverableSession(path=path, session=load_session(path, catalogue), age_s=age_s))
    return tuple(sorted(found, key=lambda left: left.age_s))


def discard_session(left: RecoverableSession) -> None:
    """It is not wanted, or has been taken up."""
    for path in (left.path, _lock_of(left.path)):
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def _lock_of(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(SESSION_SUFFIX) + _LOCK)


def _in_use(lock: Path) -> bool:
    if not lock.exists():
        return False
    with lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
