"""The gelslim_depth data set: one `.pt` file of many grasps, both fingers in the channels.

Keys and shapes are those of the published data: `tactile_image`, `base_tactile_image` (n, 6, 320, 427) with the left
finger's RGB before the right one's, `depth_image` (n, 2, 320, 427) in mm: 0 without contact, negative where pressed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import freeze
from pipeline.base.errors import FileProblem
from pipeline.recordings import torch_files
from pipeline.recordings.index_check import with_index_check
from pipeline.values.frames import Recording, Stream, TactileFrame, Truth

_SHAPE = (320, 427)
_FINGERS = ("left", "right")
_MAX_DEPTH_MM = 10.0  # a gel of 2 mm gives way by less; more means another unit
_SIGN_TOLERANCE_MM = 0.05  # interpolation leaves a little above zero


def read(path: Path) -> Recording:
    """Two streams, `left` and `right`; the truth is indentation_mm = -depth_image where the file has one.

    Raises FileProblem for a missing key or another shape.
    """
    tensors = torch_files.load_tensors(path)
    images = torch_files.require_tensor(tensors, "tactile_image", path, (None, 6, *_SHAPE))
    base = torch_files.require_tensor_rows(tensors, "base_tactile_image", path, (6, *_SHAPE))
    # The data set's readme has the plural, its files the singular.
    depth_key = next((k for k in ("depth_image", "depth_images") if k in tensors), "")
    depth = torch_files.require_tensor(tensors, depth_key, path, (None, 2, *_SHAPE)) if depth_key else None
    n = int(images.shape[0])
    if len(base) not in (1, n) or (depth is not None and len(depth) != n):
        raise FileProblem(f"tactile_image has {n} grasps, but base_tactile_image or {depth_key} another number", path)

    def stream(finger: int) -> Stream:
        channels = slice(3 * finger, 3 * finger + 3)

        def frame(index: int) -> TactileFrame:
            image, reference = images[index, channels], base[min(index, len(base) - 1), channels]
            return TactileFrame(
                sensor="gelslim", image=torch_files.convert_to_rgb(image, "tactile_image", path),
                reference=torch_files.convert_to_rgb(reference, "base_tactile_image", path),
                index=index, origin=f"{path} [{_FINGERS[finger]}]",
                grasp_range=(float(images[index].min()), float(images[index].max())),
            )  # fmt: skip

        def truth(index: int) -> Truth | None:
            return None if depth is None else _truth(depth[index, finger], index, depth_key, path)

        return Stream(name=_FINGERS[finger], sensor="gelslim", n_frames=n, has_truth=depth is not None,
                      frame=with_index_check(frame, n, path), truth=with_index_check(truth, n, path))  # fmt: skip

    return Recording(
        path=path, format="gelslim_depth dictionary", streams=(stream(0), stream(1)), notes=_notes(tensors)
    )


def _truth(depth: Any, index: int, key: str, path: Path) -> Truth:
    values = depth.float().numpy()
    field = f"frame {index} {key}"
    if not np.isfinite(values).all():
        raise FileProblem(f"{key} of frame {index} has values that are not finite", path, field=field)
    low, high = float(values.min()), float(values.max())
    if high > _SIGN_TOLERANCE_MM:
        raise FileProblem(f"{key} of frame {index} must not be positive, got {high:g} mm", path, field=field)
    if low < -_MAX_DEPTH_MM:
        raise FileProblem(f"{key} of frame {index} must be in mm, got {low:g}", path, field=field)
    return Truth(indentation_mm=freeze(np.maximum(-values, 0.0, dtype=np.float32)))


def _notes(tensors: Mapping[str, Any]) -> tuple[str, ...]:
    notes = ["depth images are taken as millimetres, negative where pressed"]
    if "in_hand_pose" in tensors:
        notes.append("in_hand_pose is left out: its documentation says millimetres, its programs read metres")
    return tuple(notes)
