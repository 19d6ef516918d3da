"""What the commands share of the terminal: a line, a bar, and the one sentence when something is wrong."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from pipeline.base.text import escape_text

if TYPE_CHECKING:  # a sentence is said without loading what draws bars
    from rich.progress import Progress


class ProgressBar:
    """A pipeline's progress on the terminal."""

    def __init__(self, bar: Progress) -> None:
        self._bar, self._task = bar, bar.add_task("", total=1.0)

    def step(self, fraction: float, text: str) -> None:
        """Show how far it is."""
        self._bar.update(self._task, completed=fraction, description=text)


def create_progress_bar() -> Progress:
    """A bar on stderr that is gone once its work is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), console=Console(stderr=True), transient=True
    )


def print_line(text: str) -> None:
    """One line on stdout, without wrapping or colours, and whatever a file put into it as letters."""
    from rich.console import Console

    Console(soft_wrap=True, highlight=False, emoji=False).print(escape_text(text), markup=False)


def print_error(text: str) -> None:
    """One sentence on stderr; what would move the cursor or begin a line is written out."""
    sys.stderr.write(f"tactoscope: {escape_text(text)}\n")
