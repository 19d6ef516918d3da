"""Reads tensors of foreign files, safetensors or torch's, without executing code."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats
from pipeline.core.errors import FileProblem
from pipeline.core.files import MOST_NETWORK_BYTES, require_budget
from pipeline.core.progress import report_reading
from pipeline.core.torch_archive import load_torch_file, require_checksums
from pipeline.stages.networks.weights import is_safetensors, load_tensors

# share of the names; the largest part of a network that is read, an encoder, holds 0.83
_SHARED_BY = 0.9
_MOST_TENSOR_BYTES = 1 << 28  # of one tensor; the largest of a latent diffusion takes 0.12 GB
_MAX_PREFIXES = 8  # such as `module.model.` of wrappers within each other
_MAX_NESTING = 3  # levels of a training checkpoint that are searched for the table of tensors
# names in the file -> name wanted: name in the file
Selection = Callable[[Collection[str]], Mapping[str, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TensorTable:
    """Tensors of a file by name, and what else the file holds."""

    tensors: dict[str, Floats]
    other_keys: frozenset[str]  # next to the table, such as "optimizer"; empty for a bare table


def select_all(names: Collection[str]) -> Mapping[str, str]:
    """Every tensor under its name."""
    return {name: name for name in names}


def read_tensors(path: Path, select: Selection = select_all) -> TensorTable:
    """The selected tensors as float32; of a torch archive no others are read.

    A prefix that nearly all names share, such as that of distributed training, is dropped before
    `select` sees them. `select` may raise FileProblem. Raises FileProblem if the file is not a
    table of finite tensors.
    """
    if is_safetensors(path):
        return _take(_drop_prefix(load_tensors(path)[1]), select, frozenset(), path)
    require_checksums(path)
    table, others = _find_table(load_torch_file(path), path)
    return TensorTable(tensors=_read_selected(table, select(table.keys()), path), other_keys=others)


def _read_selected(
    table: Mapping[str, Any], wanted: Mapping[str, str], path: Path
) -> dict[str, Floats]:
    total = sum(table[stored].numel() for stored in wanted.values())
    done = 0
    require_budget(4 * total, "the weights", path, most=MOST_NETWORK_BYTES)
    for stored in wanted.values():
        require_budget(
            4 * table[stored].numel(), f"the tensor {stored!r}", path, most=_MOST_TENSOR_BYTES
        )
    tensors: dict[str, Floats] = {}
    for name, stored in wanted.items():
        tensor = table[stored].detach()
        if tensor.is_complex() or tensor.is_sparse or tensor.is_quantized:
            raise FileProblem("a tensor has a type of numbers that is not supported", path)
        tensors[name] = _convert(tensor.float().numpy(), path)
        done += tensor.numel()
        report_reading(done / max(total, 1), f"reading {path.name}")
    return tensors


def _take(
    tensors: Mapping[str, NDArray[Any]], select: Selection, others: frozenset[str], path: Path
) -> TensorTable:
    taken = {
        name: _convert(tensors[stored], path) for name, stored in select(tensors.keys()).items()
    }
    return TensorTable(tensors=taken, other_keys=others)


def _find_table(content: Any, path: Path) -> tuple[dict[str, Any], frozenset[str]]:
    """The table of tensors of a checkpoint, and the keys next to it.

    Raises FileProblem if there is none.

    The table is the mapping with most tensors, the first of several: averages and the optimiser's
    state follow it.
    """
    tables = list(_list_tables(content, (), set()))
    if not tables:
        raise FileProblem(
            "the weights are not a table of named tensors; save the network's state_dict", path
        )
    table, above = max(tables, key=lambda found: len(found[0]))
    return _drop_prefix(table), frozenset(
        str(key) for outer, inner in above for key in outer if key != inner
    )


# mappings around a table, each with the key of the next one
_Place = tuple[tuple[Mapping[Any, Any], Any], ...]


def _list_tables(
    content: Any, above: _Place, seen: set[int]
) -> Iterator[tuple[dict[str, Any], _Place]]:
    """Mappings that hold tensors under names, outer ones first, each once, with those around it."""
    if not isinstance(content, Mapping) or len(above) == _MAX_NESTING or id(content) in seen:
        return
    seen.add(id(content))
    named = cast("Mapping[Any, Any]", content)
    table = {
        name: tensor
        for name, tensor in named.items()
        if isinstance(name, str) and hasattr(tensor, "shape")
    }
    if table:
        yield table, above
    for key, value in named.items():
        yield from _list_tables(value, (*above, (named, key)), seen)


def _drop_prefix(table: dict[str, Any]) -> dict[str, Any]:
    """The table without the parts in front that nearly all its names share, such as `module.`.

    The few others are those of a wrapper: a counter of averages, a metric, a weighted loss.
    """
    for _ in range(_MAX_PREFIXES):
        firsts = Counter(name.partition(".")[0] for name in table if "." in name)
        first, count = max(firsts.items(), key=itemgetter(1), default=("", 0))
        if len(table) < 2 or count < _SHARED_BY * len(table):
            return table
        table = {
            name.partition(".")[2]: tensor
            for name, tensor in table.items()
            if name.startswith(f"{first}.")
        }
    return table


def _convert(tensor: NDArray[Any], path: Path) -> Floats:
    """The tensor as float32; filters in channels-last order, in which networks use them, so that
    none copies them.
    """
    values = np.asarray(tensor, np.float32)
    if not np.isfinite(values).all():
        raise FileProblem("the weights contain NaN or infinity; download them again", path)
    if values.ndim != 4:
        return np.ascontiguousarray(values).reshape(values.shape)
    return np.ascontiguousarray(values.transpose(0, 2, 3, 1)).transpose(0, 3, 1, 2)
