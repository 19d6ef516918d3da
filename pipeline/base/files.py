"""Files that are whole or not there: everything is written beside its place and moved in at the end."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.base.errors import FileProblem


def write_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Have `fill` write into a new folder that takes the place of `folder` once it is complete."""
    part = folder.with_name(f".{folder.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        fill(part)
        if folder.exists():
            shutil.rmtree(folder)
        part.replace(folder)
    except OSError as error:
        raise FileProblem(f"cannot write the results ({error.strerror})", folder) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def ready(folder: Path) -> None:
    """Make sure that `folder` is there and can be written to, before the work whose results it is for.

    Raises FileProblem otherwise.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".ready", dir=folder):
            pass
    except OSError as error:
        raise FileProblem(f"no results can be written here ({error.strerror}); choose another place", folder) from error


def write_json(path: Path, value: object) -> None:
    """`value` as indented JSON; numbers that are not finite become null, which JSON has a word for."""
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(_plain(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise FileProblem(f"cannot write the report ({error.strerror})", path) from error


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """`arrays` as one .npz, lightly compressed; opened again without pickle."""
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]
        file.flush()
        os.fsync(file.fileno())


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
