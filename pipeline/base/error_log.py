"""An error that nobody foresaw: one sentence for the user, and its traceback in a file for whoever mends it."""

from __future__ import annotations

import contextlib
import tempfile
import time
import traceback
from pathlib import Path

MAX_LOG_BYTES = 1_000_000  # a longer file of details is put aside, and the one before it goes


def format_sentence(error: BaseException) -> str:
    """What happened, by the error's kind and the first line of its text."""
    first = str(error).strip().splitlines()
    return f"something unexpected went wrong ({type(error).__name__}{': ' + first[0] if first else ''})"


def format_details(error: BaseException) -> str:
    """The traceback."""
    return "".join(traceback.format_exception(error))


def log_error(error: BaseException) -> str:
    """The sentence, with the file that the details were added to."""
    entry = f"{time.strftime('%Y-%m-%d %H:%M:%S')}\n{format_details(error)}\n"
    for folder in (_own_folder(), Path(tempfile.gettempdir())):
        path = folder / "tactoscope.log"
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if path.exists() and path.stat().st_size > MAX_LOG_BYTES:
                path.replace(path.with_suffix(".old.log"))
            with path.open("a", encoding="utf-8", errors="backslashreplace") as file:
                file.write(entry)
            return f"{format_sentence(error)}; the details are in '{path}'"
    return f"{format_sentence(error)}; there is nowhere to write its details to"


def _own_folder() -> Path:
    import platformdirs

    return Path(platformdirs.user_log_dir("tactoscope", appauthor=False))
