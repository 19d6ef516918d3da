"""Finds the weights of a method: shipped ones, those of a file, or the reason why there are none.

Nothing is raised: a method without weights uses its fallback and reports it.
"""

from pathlib import Path
from typing import Any

from pipeline.core.errors import FileProblem
from pipeline.core.memo import Memo
from pipeline.stages.networks.published_weights import ReadWeights, get_description_path
from pipeline.stages.networks.weights import (
    SUFFIX,
    NoWeights,
    Weights,
    load_weights,
    load_weights_of_package,
    stamp_file,
)

_SOURCE = Path(__file__).parents[3] / "sample_data" / "weights"
_WHEEL = Path(__file__).parent / "shipped"
WEIGHTS_FOLDER = _SOURCE if _SOURCE.is_dir() else _WHEEL
_MAX_BYTES = 2 << 30
# entry of a model card: kind of the sensor that touches are generated for
TARGET_KIND = "target kind"
_read: Memo[tuple[Any, ...], Weights] = Memo(
    8, most_bytes=_MAX_BYTES, weigh=lambda weights: 4 * weights.n_parameters
)  # by file, modification time and size


def load_shipped(name: str) -> Weights | NoWeights:
    """The shipped weights of this name."""
    path = WEIGHTS_FOLDER / f"{name}{SUFFIX}"
    if not path.is_file():
        return NoWeights(
            why=f"no weights {name!r} are shipped; train them with `tactoscope train` or choose a "
            "file with --weights"
        )
    return load_file(path, load_weights_of_package)


def load_file(path: Path, read: ReadWeights = load_weights) -> Weights | NoWeights:
    """The weights of a file, cached until the file changes."""
    try:
        try:
            stamps = [
                stamp_file(file)
                for file in (path, get_description_path(path))
                if file == path or file.is_file()
            ]
        except (OSError, ValueError):
            return read(path)  # raises the FileProblem
        key = (read.__module__, read.__qualname__, path, *stamps)
        return _read.get_or_make(key, lambda: read(path))
    except FileProblem as problem:
        return NoWeights(why=str(problem))


def load_for_task(
    task: str | tuple[str, ...],
    name: str,
    file: Path | None,
    read: ReadWeights = load_weights,
    target_kind: str = "",
) -> Weights | NoWeights:
    """Weights trained for a task of `pipeline.lab.training` (or one of several): of `file`, or the
    shipped `name`.

    Weights whose card names another kind of target sensor than `target_kind` are not used.
    """
    tasks = (task,) if isinstance(task, str) else task
    weights = load_shipped(name) if file is None else load_file(file, read)
    if isinstance(weights, NoWeights):
        return weights
    trained_for = weights.card.get("task", "something else")
    if trained_for not in tasks:
        return NoWeights(
            why=f"the weights {weights.name!r} were trained for {trained_for}, not {tasks[0]}; "
            "choose others with --weights"
        )
    kind = weights.card.get(TARGET_KIND, target_kind)
    if target_kind and kind != target_kind:
        return NoWeights(
            why=f"the weights {weights.name!r} generate touches of a {kind}, not of a "
            f"{target_kind}; choose others with --weights"
        )
    return weights
