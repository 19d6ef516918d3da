"""Folders of this program for the current user: cache, log and state."""

import contextlib
import tempfile
import time
import traceback
from functools import cache
from pathlib import Path
from typing import Literal

FolderKind = Literal["cache", "log", "state"]


def find_user_folder(kind: FolderKind) -> Path:
    """Return the user's folder; a temporary one of this process where the user has no home, as
    in some containers.
    """
    return _find_folder(kind) or make_temporary_folder() / kind


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


def make_temporary_folder() -> Path:
    """Return a new folder that lasts as long as this process; the same one for each call."""
    return Path(_hold_temporary_folder().name)


@cache
def _hold_temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tactoscope-")


MAX_LOG_BYTES = 1_000_000  # a longer log is renamed and replaces the previous one


def format_sentence(error: BaseException) -> str:
    """Return one sentence of the error's class and the first line of its text."""
    first = str(error).strip().splitlines()
    return f"unexpected error ({type(error).__name__}{': ' + first[0] if first else ''})"


def format_details(error: BaseException) -> str:
    """Return the traceback."""
    return "".join(traceback.format_exception(error))


def log_error(error: BaseException) -> str:
    """Append the details to the log; returns the sentence with the log's path."""
    entry = f"{time.strftime('%Y-%m-%d %H:%M:%S')}\n{format_details(error)}\n"
    for folder in (find_user_folder("log"), Path(tempfile.gettempdir())):
        path = folder / "tactoscope.log"
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if path.exists() and path.stat().st_size > MAX_LOG_BYTES:
                path.replace(path.with_suffix(".old.log"))
            with path.open("a", encoding="utf-8", errors="backslashreplace") as file:
                file.write(entry)
            return f"{format_sentence(error)}; the details are in '{path}'"
    return f"{format_sentence(error)}; its details could not be written"
