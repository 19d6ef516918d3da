"""Terminal output shared by the commands: lines, error sentences, and a progress bar that Ctrl-C
and SIGTERM end.

A signal sets a flag that the work checks at its next step: an exception raised at an arbitrary
point could be swallowed while a kernel compiles, or leave a file half written.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pipeline.core.errors import escape_text, shorten_text

if TYPE_CHECKING:  # an error sentence is printed without loading rich
    from rich.console import Console
    from rich.progress import Progress, TaskID


class TerminalProgress:
    """A pipeline progress shown on the terminal.

    Ends the work at its next step after a request to stop.
    """

    def __init__(self, bar: Progress, task: TaskID, total: float) -> None:
        self._bar = bar
        self._task = task
        self._total = total
        self._stop_requested = False

    def request_stop(self, *_signal: object) -> None:
        """Stop the work at its next step."""
        self._stop_requested = True
        self.show("stopping")

    def show(self, text: str) -> None:
        """Show what is being done."""
        self._bar.update(self._task, description=text)

    def step(self, fraction: float, text: str) -> None:
        """Show the fraction done and what is being done.

        Raises KeyboardInterrupt after a request to stop.
        """
        self._bar.update(self._task, completed=round(fraction * self._total, 6), description=text)
        if self._stop_requested:
            raise KeyboardInterrupt


@contextmanager
def open_progress_bar(
    n_pieces: int = 0, console: Console | None = None
) -> Generator[TerminalProgress]:
    """Progress bar on stderr that disappears when the work is done.

    Counts `n_pieces`, or shows per cent for 0.

    Nothing is drawn where the console is no terminal: a log or a pipe gets the command's own lines
    alone.
    """
    from rich import progress
    from rich.console import Console

    counter = progress.MofNCompleteColumn() if n_pieces else progress.TaskProgressColumn()
    text = progress.TextColumn("{task.description}", markup=False)
    left = progress.TimeRemainingColumn()
    console = console or Console(stderr=True)
    total = float(n_pieces or 1)
    columns = (text, progress.BarColumn(), counter, left)
    with progress.Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        shown = TerminalProgress(bar, bar.add_task("", total=total), total)
        with handle_interrupts(shown.request_stop):
            yield shown


@contextmanager
def handle_interrupts(handler: Callable[..., None]) -> Generator[None]:
    """Call `handler` on Ctrl-C and SIGTERM while the context lasts.

    No effect outside the main thread.
    """
    is_main = threading.current_thread() is threading.main_thread()
    previous = {
        kind: signal.signal(kind, handler) for kind in (signal.SIGINT, signal.SIGTERM) if is_main
    }
    try:
        yield
    finally:
        for kind, old_handler in previous.items():
            signal.signal(kind, old_handler)


def print_line(text: str) -> None:
    """Print one line on stdout without wrapping or markup; control characters are escaped."""
    from rich.console import Console

    Console(soft_wrap=True, highlight=False, emoji=False).print(escape_text(text), markup=False)


def print_table(
    columns: Iterable[str],
    rows: Iterable[Iterable[str]],
    *,
    title: str | None = None,
    width: int | None = None,
    most_letters: int = 1000,
) -> None:
    """Print a table on stdout.

    Cells are shortened to `most_letters` and may hold names of a file: they are no markup.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*columns, title=title)
    for row in rows:
        table.add_row(*(Text(shorten_text(escape_text(cell), most_letters)) for cell in row))
    Console(width=width).print(table)


def format_number(value: float | None, form: str) -> str:
    """Return a number in a format such as `.2f`; a dash where it is not known."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def print_error(text: str) -> None:
    """Print one sentence on stderr; control characters and line breaks are escaped."""
    sys.stderr.write(f"tactoscope: {escape_text(text)}\n")
