"""The user's own arrangements of the window, in a file beside the program's settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from app.session.layout import Layout, from_plain
from pipeline.base.errors import FileProblem
from pipeline.base.files import read_json, set_aside, write_json

ARRANGEMENTS_FILE = "arrangements.json"
_KIND, _VERSION = "tactoscope arrangements", 1


def load_arrangements(path: Path) -> tuple[Layout, ...]:
    """Those in the file at `path`, none where there is no file; raises FileProblem."""
    if not path.exists():
        return ()
    data = read_json(path, "the arrangements")
    version = cast("dict[str, Any]", data).get(_KIND) if isinstance(data, dict) else None
    if version != _VERSION:
        raise FileProblem(
            f"your arrangements are of version {version!r} where {_VERSION} is read; save them anew, the old file is "
            "put aside",
            path,
        )
    try:
        found = tuple(from_plain(one) for one in cast("dict[str, Any]", data)["arrangements"])
    except (KeyError, TypeError, ValueError) as error:
        raise FileProblem(f"your arrangements cannot be used ({error}); save them anew", path) from error
    if any(layout.arrangement is None for layout in found):
        raise FileProblem("one of your arrangements has no name; save them anew", path)
    return found


def save_arrangements(path: Path, layouts: Sequence[Layout]) -> None:
    """Write these; a file that cannot be read is put aside first. Raises FileProblem."""
    try:
        load_arrangements(path)
    except FileProblem:
        set_aside(path)
    write_json(path, {_KIND: _VERSION, "arrangements": [layout.plain for layout in layouts]}, "your arrangements")
