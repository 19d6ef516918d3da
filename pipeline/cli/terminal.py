"""Terminal output shared by the commands: lines, progress bars and error sentences."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from pipeline.base.text import escape_text

if TYPE_CHECKING:  # an error sentence is printed without loading rich
    from rich.progress import Progress as RichProgress

    from pipeline.base.progress import Progress


class ProgressBar:
    """A pipeline progress shown on the terminal."""

    def __init__(self, bar: RichProgress) -> None:
        self._bar, self._task = bar, bar.add_task("", total=1.0)

    def step(self, fraction: float, text: str) -> None:
        """Show the fraction done and what is being done."""
        self._bar.update(self._task, completed=fraction, description=text)


class InterruptibleBar:
    """Progress bar that Ctrl-C ends at the next step."""

    def __init__(self, bar: ProgressBar, interrupts: Progress) -> None:
        self._bar, self._interrupts = bar, interrupts

    def step(self, fraction: float, text: str) -> None:
        """Show progress, or raise KeyboardInterrupt."""
        self._interrupts.step(fraction, text)
        self._bar.step(fraction, text)


def create_progress_bar() -> RichProgress:
    """Progress bar on stderr that disappears when the work is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    return Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), console=Console(stderr=True), transient=True
    )


def print_line(text: str) -> None:
    """Print one line on stdout without wrapping or markup; control characters are escaped."""
    from rich.console import Console

    Console(soft_wrap=True, highlight=False, emoji=False).print(escape_text(text), markup=False)


def print_error(text: str) -> None:
    """Print one sentence on stderr; control characters and line breaks are escaped."""
    sys.stderr.write(f"tactoscope: {escape_text(text)}\n")
