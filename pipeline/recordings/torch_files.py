"""PyTorch files, loaded without running anything that they contain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem


def tensors(path: Path) -> Mapping[str, Any]:
    """The dictionary of tensors in a `.pt` file, mapped rather than read where the file allows it.

    Raises FileProblem when it is no such file, or holds objects that only unpickling could restore.
    """
    import torch

    try:
        mapped = _is_zip(path)
        if not mapped and not _starts_like_a_pickle(path):
            raise FileProblem("this is not a PyTorch file, or it is cut short", path)
    except OSError as error:
        raise FileProblem(f"cannot read the file ({error.strerror})", path) from error
    try:
        found = torch.load(path, map_location="cpu", weights_only=True, mmap=mapped)
    except Exception as error:  # torch raises half a dozen unrelated kinds for damaged files
        if "weights_only" in str(error) or "Unsupported" in str(error):
            raise FileProblem(
                "the file holds more than tensors and loading it could run code; it is refused, save plain tensors",
                path,
            ) from error
        raise FileProblem("this is not a PyTorch file, or it is cut short", path) from error
    if not isinstance(found, dict):
        raise FileProblem(f"the file must hold a dictionary of tensors, it holds a {type(found).__name__}", path)
    return cast("Mapping[str, Any]", found)


def _starts_like_a_pickle(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(1) == b"\x80"  # every binary pickle names its protocol first


def numbers(found: Mapping[str, Any], key: str, path: Path, tail: tuple[int, ...]) -> Any:
    """The tensor of `key`, whose last dimensions must be `tail`; raises FileProblem naming the key."""
    if key not in found:
        raise FileProblem(
            f"the key {key!r} is missing; there are {', '.join(sorted(map(str, found)))}", path, field=key
        )
    value = found[key]
    shape = tuple(getattr(value, "shape", ()))
    if shape[-len(tail) :] != tail:
        raise FileProblem(f"{key} must end in shape {tail}, got {shape}", path, field=key)
    return value


def as_rgb(channels_first: Any, key: str, path: Path) -> Image:
    """(rows, cols, 3) uint8 of a tensor (3, rows, cols) that holds 0..255."""
    values = cast("NDArray[np.float32]", channels_first.float().numpy())
    low, high = float(values.min()), float(values.max())
    if not (low >= -0.5 and high <= 255.5):
        raise FileProblem(f"{key} must hold grey levels of 0 to 255, got {low:g} to {high:g}", path, field=key)
    if 0 < high <= 1.0:
        raise FileProblem(f"{key} must hold grey levels of 0 to 255, but none exceeds {high:g}; are they 0 to 1?", path,
                          field=key)  # fmt: skip
    return freeze(np.ascontiguousarray(np.moveaxis(np.clip(np.rint(values), 0, 255).astype(np.uint8), 0, 2)))


def _is_zip(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04"
