"""C libraries write nothing to the terminal; this program does."""

from __future__ import annotations

import os
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from pipeline.core.errors import TouchError
from pipeline.core.native_stderr import silence_native_libraries
from pipeline.io import open_recording
from pipeline.translation.reports.video import count_frames, write_video

GREY = np.full((64, 64, 3), 90, np.uint8)


def damage(content: bytes) -> Iterator[bytes]:
    """The first half, and the whole with its middle overwritten."""
    middle = len(content) // 2
    yield content[:middle]
    yield content[:middle] + b"\x1b[31mred" + content[middle + 8 :]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".avi", ".mp4"])
def test_a_damaged_file_writes_nothing_to_the_terminal(tmp_path, capfd, suffix):
    path = tmp_path / f"a{suffix}"
    if suffix in (".avi", ".mp4"):
        write_video(path, [GREY] * 3, 10.0)
    else:
        assert cv2.imwrite(
            str(path), np.random.default_rng(0).integers(0, 255, GREY.shape, np.uint8)
        )
    for content in damage(path.read_bytes()):
        path.write_bytes(content)
        try:
            recording = open_recording(path, sensor="digit")
            for index in range(recording.streams[0].n_frames):
                recording.streams[0].frame(index)
            recording.close()
        except TouchError:
            pass
        if suffix in (".avi", ".mp4"):
            count_frames(path)
    assert capfd.readouterr().err == ""


def test_the_program_speaks_again_after_the_last_of_two_that_overlap(capfd):
    outer = silence_native_libraries()
    inner = silence_native_libraries()
    outer.__enter__()
    inner.__enter__()
    outer.__exit__(None, None, None)
    os.write(2, b"of a library")
    inner.__exit__(None, None, None)
    os.write(2, b"of the program")
    assert capfd.readouterr().err == "of the program"
