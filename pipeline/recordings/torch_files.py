"""PyTorch files, loaded without running anything that they contain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Image, freeze
from pipeline.base.errors import FileProblem
from pipeline.base.files import describe_os_error, require_file
from pipeline.base.text import is_text


def load_tensors(path: Path) -> Mapping[str, Any]:
    """The dictionary of tensors in a `.pt` file, mapped rather than read where the file allows it.

    Raises FileProblem when it is no such file, or holds objects that only unpickling could restore.
    """
    import torch

    require_file(path, "the tensors", most_bytes=1 << 50)
    try:
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise FileProblem(f"cannot read the tensors ({describe_os_error(error)})", path) from error
    if head != b"PK\x03\x04" and head[:1] != b"\x80":  # every binary pickle names its protocol first
        raise FileProblem("this is not a PyTorch file, or it is cut short", path)
    mapped = head[:1] == b"P" and is_text(str(path))
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


def require_tensor(found: Mapping[str, Any], key: str, path: Path, shape: tuple[int | None, ...]) -> Any:
    """The tensor of `key`, of real numbers in memory and of this shape (None = any length, but some).

    Raises FileProblem naming the key.
    """
    value = _plain_tensor(found, key, path)
    seen = tuple(value.shape)
    if len(seen) != len(shape) or 0 in seen or any(n not in (None, m) for n, m in zip(shape, seen, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise FileProblem(f"{key} must have shape ({wanted}), got {seen}", path, field=key)
    return value


def require_tensor_rows(found: Mapping[str, Any], key: str, path: Path, tail: tuple[int, ...]) -> Any:
    """The tensor of `key` as at least one row (n, *tail), in however many dimensions they are kept."""
    value = _plain_tensor(found, key, path)
    seen = tuple(value.shape)
    if seen[-len(tail) :] != tail or 0 in seen:
        raise FileProblem(f"{key} must end in shape {tail}, got {seen}", path, field=key)
    return value.reshape(-1, *tail)


def _plain_tensor(found: Mapping[str, Any], key: str, path: Path) -> Any:
    import torch

    if key not in found:
        raise FileProblem(
            f"the key {key!r} is missing; there are {', '.join(sorted(map(str, found)))}", path, field=key
        )
    value = found[key]
    if not isinstance(value, torch.Tensor):
        raise FileProblem(f"{key} must be a tensor, it is a {type(value).__name__}", path, field=key)
    odd = value.layout != torch.strided or value.device.type != "cpu"
    if odd or value.dtype not in (torch.uint8, torch.int16, torch.int32, torch.int64, torch.float16, torch.bfloat16,
                                  torch.float32, torch.float64):  # fmt: skip
        raise FileProblem(f"{key} must hold plain real numbers, it is {value.dtype} on {value.device}", path, field=key)
    return value.detach()


def convert_to_rgb(channels_first: Any, key: str, path: Path) -> Image:
    """(rows, cols, 3) uint8 of a tensor (3, rows, cols) that holds 0..255."""
    values = cast("NDArray[np.float32]", channels_first.float().numpy())
    low, high = float(values.min()), float(values.max())
    if not (low >= -0.5 and high <= 255.5):
        raise FileProblem(f"{key} must hold grey levels of 0 to 255, got {low:g} to {high:g}", path, field=key)
    if 0 < high <= 1.0:
        raise FileProblem(f"{key} must hold grey levels of 0 to 255, but none exceeds {high:g}; are they 0 to 1?", path,
                          field=key)  # fmt: skip
    return freeze(np.ascontiguousarray(np.moveaxis(np.clip(np.rint(values), 0, 255).astype(np.uint8), 0, 2)))
