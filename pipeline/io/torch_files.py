"""Load PyTorch files without running code that they contain."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Image, freeze
from pipeline.core.errors import FileProblem
from pipeline.core.files import require_budget
from pipeline.core.torch_archive import PICKLE_SIGNATURE, SIGNATURE, ZIP_ERRORS, load_torch_file
from pipeline.io.formats import RecordingFiles


def is_torch_file(files: RecordingFiles) -> bool:
    """Whether the file is a PyTorch archive, or a pickle named `.pt` or `.pth`."""
    with files.path.open("rb") as file:
        head = file.read(4)
    if not head.startswith(SIGNATURE):
        return head[:1] == PICKLE_SIGNATURE and files.path.suffix.lower() in (".pt", ".pth")
    try:
        with zipfile.ZipFile(files.path) as archive:
            return any(name.endswith("/data.pkl") for name in archive.namelist())
    except ZIP_ERRORS:
        return False


def load_tensors(path: Path) -> Mapping[str, Any]:
    """The dictionary of tensors in a `.pt` file, memory-mapped where the file allows it.

    Raises FileProblem for another kind of file, or one with objects that only unpickling restores.
    """
    tensors = load_torch_file(path, only_tensors=True)
    if not isinstance(tensors, dict):
        raise FileProblem(
            f"the file must hold a dictionary of tensors, it holds a {type(tensors).__name__}", path
        )
    return cast("Mapping[str, Any]", tensors)


def require_tensor(
    tensors: Mapping[str, Any], key: str, path: Path, shape: tuple[int | None, ...]
) -> Any:
    """The tensor of `key`, which must hold real numbers and have this shape (None = any length
    above 0).

    Raises FileProblem naming the key.
    """
    value = _get_plain_tensor(tensors, key, path)
    got = tuple(value.shape)
    if (
        len(got) != len(shape)
        or 0 in got
        or any(n not in (None, m) for n, m in zip(shape, got, strict=True))
    ):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise FileProblem(f"{key} must have shape ({wanted}), got {got}", path)
    return value


def require_tensor_rows(
    tensors: Mapping[str, Any], key: str, path: Path, tail: tuple[int, ...]
) -> Any:
    """The tensor of `key` reshaped to (n, *tail), n > 0."""
    value = _get_plain_tensor(tensors, key, path)
    got = tuple(value.shape)
    if got[-len(tail) :] != tail or 0 in got:
        raise FileProblem(f"{key} must end in shape {tail}, got {got}", path)
    return value.reshape(-1, *tail)


def _get_plain_tensor(tensors: Mapping[str, Any], key: str, path: Path) -> Any:
    import torch

    if key not in tensors:
        raise FileProblem(
            f"the key {key!r} is missing; there are {', '.join(sorted(map(str, tensors)))}",
            path,
        )
    value = tensors[key]
    if not isinstance(value, torch.Tensor):
        raise FileProblem(f"{key} must be a tensor, it is a {type(value).__name__}", path)
    is_unusual = value.layout != torch.strided or value.device.type != "cpu"
    known = (torch.uint8, torch.int16, torch.int32, torch.int64, torch.float16, torch.bfloat16)
    if is_unusual or value.dtype not in (*known, torch.float32, torch.float64):
        raise FileProblem(
            f"{key} must hold plain real numbers, it is {value.dtype} on {value.device}",
            path,
        )
    row = value.detach()[:1] if value.ndim > 2 else value
    require_budget(4 * row.numel(), f"{key} of one frame" if value.ndim > 2 else key, path)
    return value.detach()


def convert_to_rgb(channels_first: Any, key: str, path: Path) -> Image:
    """The image (rows, cols, 3) uint8 of a tensor (3, rows, cols) with values 0..255.

    Raises FileProblem.
    """
    values = cast("NDArray[np.float32]", channels_first.float().numpy())
    low = float(values.min())
    high = float(values.max())
    want = f"{key} must hold grey levels of 0 to 255"
    if not (low >= -0.5 and high <= 255.5):
        raise FileProblem(f"{want}, got {low:g} to {high:g}", path)
    if 0 < high <= 1.0:
        raise FileProblem(f"{want}, but none exceeds {high:g}; are they 0 to 1?", path)
    return freeze(
        np.ascontiguousarray(np.moveaxis(np.clip(np.rint(values), 0, 255).astype(np.uint8), 0, 2))
    )
