"""The weights that a method reads: those that come along, or those of a file; or why there are none.

Nothing is raised here: whoever has no network answers without one, and says so.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pipeline.base.errors import FileProblem
from pipeline.base.memo import Memo
from pipeline.networks import depth_anything_files, latent_diffusion_files, vqvae_files
from pipeline.networks.weights import SUFFIX, NoWeights, Weights, load_weights

_SOURCE, _WHEEL = Path(__file__).parents[2] / "sample_data" / "weights", Path(__file__).parent / "shipped"
WEIGHTS_FOLDER = _SOURCE if _SOURCE.is_dir() else _WHEEL
_MOST_BYTES = 2 << 30
_read: Memo[tuple[Any, ...], Weights] = Memo(
    8, most_bytes=_MOST_BYTES, weigh=lambda weights: 4 * weights.n_parameters
)  # by file and the time of its last change


def load_shipped(name: str) -> Weights | NoWeights:
    """The weights of that name that come along."""
    path = WEIGHTS_FOLDER / f"{name}{SUFFIX}"
    if not path.is_file():
        return NoWeights(why=f"no weights {name!r} come along; train them with `tactoscope train`, or give --weights")
    return load_file(path)


def select_reader(kind: str) -> Callable[[Path], Weights]:
    """What reads files of weights for that kind of network; it raises FileProblem."""
    files = (depth_anything_files, latent_diffusion_files, vqvae_files)
    return {of.KIND: of.read_weights for of in files}.get(kind, load_weights)


def load_file(path: Path, read: Callable[[Path], Weights] = load_weights) -> Weights | NoWeights:
    """The weights in a file, read once by `read`, and again when the file has changed."""
    try:
        try:
            known = path.stat()
        except (OSError, ValueError):
            return read(path)  # says in words what is wrong
        key = (read.__module__, read.__qualname__, path, known.st_mtime_ns, known.st_size)
        return _read.get_or_make(key, lambda: read(path))
    except FileProblem as problem:
        return NoWeights(why=str(problem))


def load_for_task(
    task: str | tuple[str, ...], name: str, file: Path | None, read: Callable[[Path], Weights] = load_weights
) -> Weights | NoWeights:
    """The weights of a task of `pipeline.training`, or of one of some: in `file`, by `read`, or the shipped `name`."""
    tasks = (task,) if isinstance(task, str) else task
    found = load_shipped(name) if file is None else load_file(file, read)
    if isinstance(found, Weights) and found.card.get("task") not in tasks:
        other = found.card.get("task", "something else")
        return NoWeights(
            why=f"the weights {found.name!r} have learned {other}, not {tasks[0]}; give others as --weights"
        )
    return found
