"""Simulated recordings as a folder in the layout of the touch2touch data set."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import torch

from pipeline.core.values.frames import Stream
from pipeline.io import open_recording
from pipeline.sensors.spec import load_sensor

# of the released window in the camera's image
_TOP = 20
_LEFT = 25


def write_grasps(recording: Path, split_folder: Path, tool: str, first: int = 0) -> int:
    """Two moments of a recording of both sensors are the fingers of one grasp.

    Returns the number of grasps.
    """
    with closing(open_recording(recording)) as opened:
        gel, bubble = (opened.stream_of_sensor(name) for name in ("gelslim", "soft_bubble"))
        assert gel is not None
        assert bubble is not None
        n = bubble.n_frames // 2
        for number in range(n):
            moments = 2 * number, 2 * number + 1
            in_hand = {
                "theta": torch.tensor(0.1 * number),
                "x": torch.tensor(0.001),
                "y": torch.tensor(0.0),
            }
            save(
                split_folder / "gelslims" / f"{tool}_data_{first + number}.pt",
                {**make_gel_file(gel, moments), **in_hand},
            )
            save(
                split_folder / "bubbles" / f"{tool}_data_{first + number}.pt",
                {**make_bubble_file(bubble, moments), **in_hand},
            )
        return n


def make_gel_file(stream: Stream, moments: tuple[int, int]) -> dict[str, torch.Tensor]:
    frames = [stream.frame(k) for k in moments]
    return {
        key: torch.from_numpy(
            np.stack([np.moveaxis(image, 2, 0).astype(np.float32) for image in images])
        )
        for key, images in {
            "gelslim": [f.image for f in frames],
            "gelslim_ref": [f.reference for f in frames],
        }.items()
    }


def make_bubble_file(stream: Stream, moments: tuple[int, int]) -> dict[str, torch.Tensor]:
    frames = [stream.frame(k) for k in moments]
    images, references = (
        np.nan_to_num(np.stack(a))
        for a in ([f.image for f in frames], [f.reference for f in frames])
    )
    camera = frames[0].camera or load_sensor("soft_bubble").camera
    k = [
        [camera.fx_px, 0.0, camera.cx_px + _LEFT],
        [0.0, camera.fy_px, camera.cy_px + _TOP],
        [0.0, 0.0, 1.0],
    ]
    return {
        "bubble_imprint": torch.from_numpy(
            (references - images)[:, None].astype(np.float32) / 1000.0
        ),
        "bubble_depth_ref": torch.from_numpy(references[:, None].astype(np.float32) / 1000.0),
        "K": torch.tensor([k, k]),
    }


def save(path: Path, tensors: dict[str, torch.Tensor]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(tensors, path)
