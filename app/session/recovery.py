"""Recovery files: one autosaved session per window, removed when the window closes normally."""

import contextlib
import fcntl
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from app.session.file_fingerprints import fingerprint_files
from app.session.state import SESSION_SUFFIX, Session, load_session, save_session
from pipeline.core.errors import TouchError
from pipeline.core.files import open_lock
from pipeline.core.user_folders import find_user_folder
from pipeline.translation.catalogue import BUILT_IN, Catalogue

_LOCK_SUFFIX = ".lock"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverableSession:
    """The autosaved session of a window that did not close normally."""

    path: Path
    session: Session | None  # None where this version cannot read it
    problem: str = ""  # why it cannot
    age_s: float


def get_recovery_folder() -> Path:
    """Folder of the recovery files."""
    return find_user_folder("state") / "recovery"


class RecoveryFile:
    """The recovery file of one window; a lock held by the process marks it as in use."""

    def __init__(self, folder: Path) -> None:
        self._name = f"session-{os.getpid()}-{time.time_ns()}"
        self.path = folder / f"{self._name}{SESSION_SUFFIX}"
        self._folder = folder
        self._lock: IO[bytes] | None = None

    def write(self, session: Session) -> None:
        """Write `session` in place of the older one; raises FileProblem."""
        if self._lock is None:
            self._lock = open_lock(self._folder / f"{self._name}{_LOCK_SUFFIX}")
        save_session(session, self.path, fingerprint_files(session))

    def remove(self) -> None:
        """Remove the file and its lock: nothing is left to recover."""
        for path in (self.path, self._folder / f"{self._name}{_LOCK_SUFFIX}"):
            path.unlink(missing_ok=True)
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def find_recoverable_sessions(
    folder: Path, catalogue: Catalogue = BUILT_IN
) -> tuple[RecoverableSession, ...]:
    """List the sessions that no running window holds, newest first, with those that cannot be
    read.
    """
    sessions: list[RecoverableSession] = []
    for path in folder.glob(f"session-*{SESSION_SUFFIX}"):
        with contextlib.suppress(OSError):
            if not _is_locked(_get_lock_path(path)):
                age_s = time.time() - path.stat().st_mtime
                sessions.append(_load(path, catalogue, age_s))
    return tuple(sorted(sessions, key=lambda recoverable: recoverable.age_s))


def _load(path: Path, catalogue: Catalogue, age_s: float) -> RecoverableSession:
    try:
        return RecoverableSession(path=path, session=load_session(path, catalogue), age_s=age_s)
    except TouchError as error:
        return RecoverableSession(path=path, session=None, problem=str(error), age_s=age_s)


def discard_session(recoverable: RecoverableSession) -> None:
    """Remove the recovery file of a session that was recovered or discarded."""
    for path in (recoverable.path, _get_lock_path(recoverable.path)):
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def _get_lock_path(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(SESSION_SUFFIX) + _LOCK_SUFFIX)


def _is_locked(lock: Path) -> bool:
    if not lock.exists():
        return False
    with lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
