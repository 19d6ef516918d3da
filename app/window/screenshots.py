"""Pictures of the window on disk."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QBuffer, QIODevice
from PyQt6.QtWidgets import QWidget

from pipeline.base.errors import FileProblem
from pipeline.base.files import open_atomic


def write_screenshot(widget: QWidget, path: Path) -> None:
    """What `widget` shows, in the format that the file's name ends in, PNG otherwise; raises FileProblem."""
    held = QBuffer()
    held.open(QIODevice.OpenModeFlag.WriteOnly)
    kind = path.suffix.removeprefix(".") or "png"
    if not widget.grab().save(held, kind):
        raise FileProblem(f"cannot write the picture (there is no way to write {kind!r}, use png)", path)
    with open_atomic(path, "the picture") as file:
        file.write(held.data().data())
