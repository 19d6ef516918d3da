"""How much memory a file may take: every reader compares what a file states with it before reading.

A few bytes can state, or unfold to, gigabytes. Where only reading tells the size, it is read in
parts of known size.
"""

from pathlib import Path

from pipeline.core.errors import FileProblem

MOST_BYTES = 1 << 30  # of what is held in memory at once of one file, unfolded
MOST_NETWORK_BYTES = 1_400_000_000  # of a network's numbers; the largest that is known takes 1.3 GB


def require_budget(
    n_bytes: int, what: str, path: Path, *, field: str | None = None, most: int = MOST_BYTES
) -> None:
    """Raise FileProblem where `what`, which the file states to unfold to `n_bytes`, is beyond
    the budget.
    """
    if n_bytes > most:
        raise FileProblem(
            f"{what} would take {n_bytes / 1e9:.1f} GB of memory, more than the {most / 1e9:.1f} "
            "GB that a file may; "
            "it is damaged, or has to be split",
            path,
            field=field,
        )
