"""Screenshots of widgets."""

from pathlib import Path

from PyQt6.QtCore import QBuffer, QIODevice
from PyQt6.QtWidgets import QWidget

from pipeline.core.errors import FileProblem
from pipeline.core.files import open_atomic


def write_screenshot(widget: QWidget, path: Path) -> None:
    """Write an image of `widget` in the format of the file's suffix, else PNG.

    Raises FileProblem.
    """
    buffer = QBuffer()
    buffer.open(QIODevice.OpenModeFlag.WriteOnly)
    kind = path.suffix.removeprefix(".") or "png"
    if not widget.grab().save(buffer, kind):
        raise FileProblem(f"cannot write the image ({kind!r} is not supported, use png)", path)
    with open_atomic(path, "the image", None) as file:
        file.write(buffer.data().data())
