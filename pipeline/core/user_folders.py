"""Folders of this program for the current user: cache, log and state."""

import tempfile
from functools import cache
from pathlib import Path
from typing import Literal

FolderKind = Literal["cache", "log", "state"]


def find_user_folder(kind: FolderKind) -> Path:
    """Return the user's folder; a temporary one of this process where the user has no home, as
    in some containers.
    """
    return _find_folder(kind) or Path(_make_temporary_folder().name) / kind


def has_home() -> bool:
    """Return whether the user has a home folder, or names the program's folders by XDG
    variables.
    """
    return _find_folder("cache") is not None and _find_folder("state") is not None


def _find_folder(kind: FolderKind) -> Path | None:
    import platformdirs

    find = {
        "cache": platformdirs.user_cache_dir,
        "log": platformdirs.user_log_dir,
        "state": platformdirs.user_state_dir,
    }
    try:
        return Path(find[kind]("tactoscope", appauthor=False))
    except RuntimeError:
        return None


@cache
def _make_temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tactoscope-")
