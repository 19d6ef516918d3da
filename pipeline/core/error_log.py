"""Log unexpected errors: one sentence for the user, the traceback in a file."""

import contextlib
import tempfile
import time
import traceback
from pathlib import Path

from pipeline.core.user_folders import find_user_folder

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
