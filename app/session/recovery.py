"""Recovery files: one autosaved session per window, removed when the window closes normally."""

import contextlib
import os
import time
from pathlib import Path
from typing import BinaryIO

from app.session.file_fingerprints import fingerprint_files
from app.session.state import SESSION_SUFFIX, Session, load_session, save_session
from pipeline.core.errors import TouchError
from pipeline.core.files import open_lock
from pipeline.core.frozen import frozen
from pipeline.core.user_folders import find_user_folder


@frozen
class RecoverableSession:
    """The autosaved session of a window that did not close normally."""

    path: Path
    session: Session | None = None  # None where this version cannot read it
    problem: str = ""  # why it cannot
    age_s: float


def get_recovery_folder() -> Path:
    """Folder of the recovery files."""
    return find_user_folder("state") / "recovery"


class RecoveryFile:
    """The recovery file of one window; a lock held by the process marks it as in use."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / f"session-{os.getpid()}-{time.time_ns()}{SESSION_SUFFIX}"
        self._lock: BinaryIO | None = None

    def write(self, session: Session) -> None:
        """Write `session` in place of the older one; raises FileProblem."""
        if self._lock is None:
            self._lock = open_lock(_get_lock_path(self.path))
        save_session(session, self.path, fingerprint_files(session))

    def unlock(self) -> None:
        """Mark it as no longer in use."""
        if self._lock is not None:
            self._lock.close()


def find_recoverable_sessions(folder: Path) -> tuple[RecoverableSession, ...]:
    """List the sessions that no running window holds, newest first, with those that cannot be
    read.
    """
    sessions: list[RecoverableSession] = []
    for path in folder.glob(f"session-*{SESSION_SUFFIX}"):
        # the lock cannot be had while a window holds it
        with contextlib.suppress(OSError, TouchError), open_lock(_get_lock_path(path)):
            sessions.append(_load(path, time.time() - path.stat().st_mtime))
    return tuple(sorted(sessions, key=lambda recoverable: recoverable.age_s))


def _load(path: Path, age_s: float) -> RecoverableSession:
    try:
        return RecoverableSession(path=path, session=load_session(path), age_s=age_s)
    except TouchError as error:
        return RecoverableSession(path=path, problem=str(error), age_s=age_s)


def remove_recovery_file(path: Path) -> None:
    """Remove a recovery file and its lock: nothing is left to recover."""
    for file in (path, _get_lock_path(path)):
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)


def _get_lock_path(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(SESSION_SUFFIX) + ".lock")
