"""Videos: a frame is the same whatever was read before, and has the time that the file gives it."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from pipeline.core.errors import FileProblem
from pipeline.io.video import VideoDecoder

N = 60
N_SLOW = 20
RATE_HZ = 25.0


def write_video(path, code="mp4v"):
    """Frame k is as grey as 20 + 3 k."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), RATE_HZ, (64, 48))
    for k in range(N):
        writer.write(np.full((48, 64, 3), 20 + 3 * k, np.uint8))
    writer.release()


def quicken(path):
    """Let the frames after the first `N_SLOW` of an MP4 file follow each other four times as
    fast.
    """
    content = bytearray(path.read_bytes())
    start = content.rfind(b"moov")
    times = content.find(b"stts", start)
    entries, count, ticks = struct.unpack(">III", content[times + 8 : times + 20])
    assert (entries, count) == (1, N)
    content[times + 8 : times + 20] = struct.pack(
        ">IIIII", 2, N_SLOW, ticks, N - N_SLOW, ticks // 4
    )
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        at = content.find(box, start) - 4
        content[at : at + 4] = struct.pack(">I", struct.unpack(">I", content[at : at + 4])[0] + 8)
    path.write_bytes(content)


def number_of(video, index):
    return round((video.frame(index).mean() - video.frame(0).mean()) / 3.0)


def test_frames_of_a_varying_rate_are_found_in_any_order(tmp_path):
    path = tmp_path / "a.mp4"
    write_video(path)
    quicken(path)
    video = VideoDecoder(path)
    assert video.n_frames == N
    order = [*range(N), *np.random.default_rng(0).permutation(N).tolist()]
    assert [number_of(video, index) for index in order] == order
    assert video.times_s[N_SLOW] == pytest.approx(N_SLOW / RATE_HZ)
    assert video.times_s[N - 1] == pytest.approx(
        (N_SLOW + 0.25 * (N - 1 - N_SLOW)) / RATE_HZ, abs=1e-3
    )
    video.close()


def test_what_a_video_lacks_at_its_end_is_damaged(tmp_path):
    path = tmp_path / "a.avi"
    write_video(path, "MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    video = VideoDecoder(path)
    assert (video.n_frames, number_of(video, 10)) == (N, 10)
    with pytest.raises(FileProblem, match=f"frame {N - 1} of the video cannot be decoded"):
        video.frame(N - 1)
    assert number_of(video, 5) == 5
    video.close()
