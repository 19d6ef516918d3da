"""Undo: one command class for every session change."""

from collections.abc import Callable
from zlib import crc32

from PyQt6.QtGui import QUndoCommand, QUndoStack

from app.session.state import Session

MAX_UNDO_STEPS = 1000  # each step holds a session


class SessionChange(QUndoCommand):
    """Change from one session to another.

    Consecutive changes with the same `key`, as in a drag, are one step.
    """

    def __init__(
        self, *, old: Session, new: Session, text: str, key: str, show: Callable[[Session], None]
    ) -> None:
        super().__init__(text)
        self.old = old
        self.new = new
        self._key = key
        self._show = show

    def id(self) -> int:
        """Return equal ids for changes that may merge, -1 for one that may not."""
        return crc32(self._key.encode()) & 0x7FFFFFFF if self._key else -1

    def mergeWith(self, other: QUndoCommand | None) -> bool:  # noqa: N802
        """Merge a following change with the same key into this one."""
        if not isinstance(other, SessionChange) or other.id() != self.id():
            return False
        self.new = other.new
        return True

    def redo(self) -> None:
        """Show the new session."""
        self._show(self.new)

    def undo(self) -> None:
        """Show the old session."""
        self._show(self.old)


def list_sessions(stack: QUndoStack) -> list[Session]:
    """List the session at every index of the stack.

    Index 0 is before the first step. [] for an empty stack.
    """
    steps = [
        step for step in map(stack.command, range(stack.count())) if isinstance(step, SessionChange)
    ]
    return [*(step.old for step in steps), *(step.new for step in steps[-1:])]
