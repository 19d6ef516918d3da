"""Undo: one command class for every change of the session."""

from __future__ import annotations

from collections.abc import Callable
from zlib import crc32

from PyQt6.QtGui import QUndoCommand, QUndoStack

from app.session.state import Session

MAX_STEPS = 1000  # that can be taken back: each holds a session, and who works all day makes thousands


class SessionChange(QUndoCommand):
    """From one session to another; changes of the same `key` that follow each other, as in a drag, are one step."""

    def __init__(self, *, old: Session, new: Session, text: str, key: str, show: Callable[[Session], None]) -> None:
        super().__init__(text)
        self.old, self.new, self._key, self._show = old, new, key, show

    def id(self) -> int:
        """Equal for changes that may be joined."""
        return crc32(self._key.encode()) & 0x7FFFFFFF if self._key else -1

    def mergeWith(self, other: QUndoCommand | None) -> bool:  # noqa: N802
        """Take a following change of the same key into this one."""
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
    """The session at every place of the stack, place 0 being before its first step; none where it has no step."""
    steps = [step for step in map(stack.command, range(stack.count())) if isinstance(step, SessionChange)]
    return [*(step.old for step in steps), *(step.new for step in steps[-1:])]
