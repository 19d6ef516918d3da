"""What a file states is checked before it is read: no few bytes fill the memory or the evening."""

from __future__ import annotations

import os
import struct
import zlib

import cv2
import numpy as np
import pytest

from pipeline.base import files
from pipeline.base.errors import FileProblem, ModelMissing
from pipeline.networks import network_factory
from pipeline.networks.weights import Weights
from pipeline.recordings import image_files, open_recording


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def test_an_image_of_30000_a_side_is_refused_by_its_head(tmp_path, capfd):
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0))
    rest = png_chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + png_chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + rest)
    with pytest.raises(FileProblem, match="too large"):
        image_files.read_rgb(tmp_path / "a.png")
    assert capfd.readouterr().err == ""


def test_arrays_that_unfold_are_refused_by_their_table_of_contents(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(100_000))
    assert (tmp_path / "a.npz").stat().st_size < 2000
    monkeypatch.setattr(files, "_MOST_ARRAY_BYTES", 100_000)
    with pytest.raises(FileProblem, match="unfold to 8e"):
        files.read_arrays(tmp_path / "a.npz", "the arrays")


def test_a_video_that_states_more_frames_than_it_can_hold_is_refused(tmp_path):
    path = tmp_path / "a.avi"
    video = cv2.VideoWriter(os.fspath(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for _ in range(5):
        video.write(np.zeros((48, 64, 3), np.uint8))
    video.release()
    content = bytearray(path.read_bytes())
    for name, at in ((b"avih", 24), (b"strh", 40)):
        start = content.index(name) + at
        content[start : start + 4] = struct.pack("<I", 9_000_000)
    path.write_bytes(content)
    with pytest.raises(FileProblem, match="the video cannot be opened"):
        open_recording(path)


@pytest.mark.parametrize("wrong", [{"levels": 10**9}, {"base_channels": 10**9}, {"levels": 0}])
def test_weights_that_state_a_network_beyond_their_tensors_are_refused(wrong):
    config = {"inputs": 1, "outputs": 1, "base_channels": 4, "levels": 2, **wrong}
    tensors = {"start.weight": np.zeros((4, 4, 3, 3), np.float32)}
    weights = Weights(name="w", kind="compact_unet", config=config, tensors=tensors)
    with pytest.raises(ModelMissing):
        network_factory.load_network(weights)
