"""Places that are odd rather than damaged: names that are no text, and what says where a file
should be read from.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from pipeline.core.errors import FileProblem
from pipeline.core.values.frames import TactileFrame
from pipeline.io import open_recording
from pipeline.io.hdf5_writer import RecordingWriter

NAME = os.fsdecode(b"caf\xe9\x1b[0m")  # Latin-1, and a mark of the terminal's
IMAGE = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)


def make(kind: str, folder: Path) -> None:
    match kind:
        case "a.h5":
            with RecordingWriter(folder / kind) as writer:
                writer.append("digit", TactileFrame(sensor="digit", image=IMAGE, reference=None))
        case "a.npz":
            np.savez(folder / kind, depth_mm=np.full((2, 6, 7), 80.0))
        case "a.pt":
            images = torch.full((2, 3, 320, 427), 60.0)
            torch.save({"gelslim": images, "gelslim_ref": images}, folder / kind)
        case "a.png":
            cv2.imwrite(str(folder / kind), IMAGE)
        case "a":
            (folder / kind).mkdir()
            cv2.imwrite(str(folder / kind / "0.png"), IMAGE)


@pytest.mark.parametrize("kind", ["a.h5", "a.npz", "a.pt", "a.png", "a"])
def test_a_file_name_that_is_no_utf8_can_be_opened(tmp_path: Path, kind: str):
    make(kind, tmp_path)
    path = shutil.move(tmp_path / kind, tmp_path / f"{NAME}{Path(kind).suffix}")
    recording = open_recording(path)
    assert recording.streams[0].frame(0).image.size
    recording.close()
    with pytest.raises(FileProblem, match=r"\\udce9\\x1b\[0m"):
        recording.streams[0].frame(99)


def test_a_video_whose_name_is_no_utf8_is_refused(tmp_path: Path):
    path = tmp_path / f"{NAME}.mp4"
    path.write_bytes(b"something")
    with pytest.raises(FileProblem, match="the name of a video must be UTF-8"):
        open_recording(path)


@pytest.mark.parametrize("name", ["x" * 300, "nul\0", "a/" * 3000])
def test_an_impossible_file_name_is_refused(tmp_path: Path, name: str):
    with pytest.raises(FileProblem, match="no such file or folder"):
        open_recording(tmp_path / name)
