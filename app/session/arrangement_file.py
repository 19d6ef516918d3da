"""The user's named window arrangements, in a file next to the program's settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import msgspec

from app.session.layout import Layout
from pipeline.base.errors import FileProblem
from pipeline.base.files import read_json, set_aside, write_json
from pipeline.base.typed_data import convert, to_plain

ARRANGEMENTS_FILE = "arrangements.json"
_KIND, _VERSION = "tactoscope arrangements", 1


class _ArrangementFile(msgspec.Struct):
    arrangements: tuple[Layout, ...]


def load_arrangements(path: Path) -> tuple[Layout, ...]:
    """Read the arrangements of the file at `path`; () if there is no file. Raises FileProblem."""
    if not path.exists():
        return ()
    data = read_json(path, "the arrangements")
    version = cast("dict[str, Any]", data).get(_KIND) if isinstance(data, dict) else None
    if version != _VERSION:
        raise FileProblem(
            f"the arrangements have version {version!r}, this program reads {_VERSION}; save them again, the old file "
            "is renamed",
            path,
        )
    layouts = convert(data, _ArrangementFile, "the arrangements", path).arrangements
    if any(layout.arrangement is None for layout in layouts):
        raise FileProblem("an arrangement has no name; save them again", path)
    return layouts


def save_arrangements(path: Path, layouts: Sequence[Layout]) -> None:
    """Write the arrangements; an unreadable old file is renamed first. Raises FileProblem."""
    try:
        load_arrangements(path)
    except FileProblem:
        set_aside(path)
    write_json(path, {_KIND: _VERSION, "arrangements": to_plain(layouts)}, "the arrangements")
