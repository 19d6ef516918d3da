"""What a file states is checked before it is read: no few bytes fill the memory or the evening."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest

from pipeline.base import files
from pipeline.base.errors import FileProblem, ModelMissing
from pipeline.networks import network_factory
from pipeline.networks.weights import Weights
from pipeline.recordings import image_files, open_recording
from pipeline.recordings.hdf5_writer import RecordingWriter
from pipeline.values.frames import TactileFrame


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
    monkeypatch.setattr(files.require_budget, "__kwdefaults__", {"field": None, "most": 100_000})
    with pytest.raises(FileProblem, match="the arrays would take"):
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


_PEAK_MB = """
import resource, sys
from pipeline.recordings import open_recording
import cv2, h5py
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
before = peak()
recording = open_recording(sys.argv[1])
recording.streams[0].frame(5)
print(recording.streams[0].n_frames, peak() - before)
"""


def test_a_recording_that_was_cut_short_is_not_copied_into_memory(tmp_path):
    path, rng = tmp_path / "cut.h5", np.random.default_rng(0)
    reference = rng.integers(0, 255, (320, 240, 3), np.uint8)
    with RecordingWriter(path) as writer:
        for index in range(300):
            image = np.roll(reference, index)
            writer.append(
                "a", TactileFrame(sensor="digit", image=image, reference=reference, index=index, time_s=index)
            )
    n_bytes = path.stat().st_size
    assert n_bytes > 40e6
    os.truncate(path, n_bytes * 9 // 10)
    done = subprocess.run([sys.executable, "-c", _PEAK_MB, path], capture_output=True, text=True, check=True)
    n_frames, grown_mb = done.stdout.split()
    assert int(n_frames) > 200
    assert float(grown_mb) < 30.0
