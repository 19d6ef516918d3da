"""MCAP files: clocks, damage, and what its topics hold."""

from __future__ import annotations

from contextlib import closing

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from pipeline.core.errors import FileProblem, select_warnings
from pipeline.io import open_recording
from pipeline.io.inspection.recording_report import inspect_recording
from tests.pipeline.io.mcap_files import compressed, raw, write_ros

SHAPE = (24, 32, 3)
START_NS = 1_744_664_892 * 10**9
STEP_NS = 33_000_000


def draw(n, seed=0):
    rng = np.random.default_rng(seed)
    return [rng.integers(20, 230, SHAPE).astype(np.uint8) for _ in range(n)]


def read_all(path, stream="", **options):
    with closing(open_recording(path, stream=stream, **options)) as recording:
        opened = recording.stream(stream)
        frames = [opened.frame(k) for k in range(opened.n_frames)]
        return [f.image for f in frames], [f.time_s for f in frames], recording.notes


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    order=st.permutations(range(7)),
    clock=st.sampled_from(["exact", "tenths", "zero", "one"]),
    compression=st.sampled_from(CompressionType),
    chunked=st.booleans(),
    ends=st.booleans(),
)
def test_no_image_is_lost_and_the_headers_order_them(
    tmp_path, order, clock, compression, chunked, ends
):
    """Log times that stand still or are in another order than the headers."""
    images = draw(7)
    logs = {"exact": 1, "tenths": 10**8, "zero": 10**30, "one": 10**30}[clock]
    rows = [
        (
            (START_NS + k * STEP_NS) // logs * logs + (clock == "one"),
            raw(images[i], START_NS + i * STEP_NS),
        )
        for k, i in enumerate(order)
    ]
    path = write_ros(
        tmp_path / "a.mcap", {"/tactile": rows}, compression=compression, chunked=chunked, ends=ends
    )
    got, times, notes = read_all(path)
    np.testing.assert_array_equal(got, images)
    assert times == pytest.approx([0.033 * k for k in range(7)])
    assert bool(select_warnings(notes)) == (not ends)


def test_without_headers_the_sequence_then_the_file_orders_equal_times(tmp_path):
    images = draw(6)
    rows = [(5, raw(image)) for image in images]
    got, times, _ = read_all(
        write_ros(tmp_path / "a.mcap", {"/tactile": rows}, sequences=[3, 1, 2, 0, 4, 4])
    )
    np.testing.assert_array_equal(got, [images[k] for k in (3, 1, 2, 0, 4, 5)])
    assert np.isnan(times).all()


def test_images_with_equal_log_times_keep_them(tmp_path):
    rows = [(k // 2 * 10**8, raw(image)) for k, image in enumerate(draw(6))]
    got, times, _ = read_all(write_ros(tmp_path / "a.mcap", {"/tactile": rows}))
    np.testing.assert_array_equal(got, draw(6))
    assert times == pytest.approx([0.0, 0.0, 0.1, 0.1, 0.2, 0.2])


def test_topics_share_one_clock(tmp_path):
    """The second topic begins 0.5 s later: its times do not begin at 0."""
    one = [
        (START_NS + k * 10**8, raw(image, START_NS + k * 10**8)) for k, image in enumerate(draw(10))
    ]
    other = [
        (START_NS + k * 10**8, raw(image, START_NS + k * 10**8))
        for k, image in enumerate(draw(5, 1), start=5)
    ]
    path = write_ros(tmp_path / "a.mcap", {"/tactile_a": one, "/tactile_b": other})
    assert read_all(path, "tactile_b")[1] == pytest.approx([0.5, 0.6, 0.7, 0.8, 0.9])
    report = inspect_recording(path)
    (check,) = [
        c for c in report.checks if c.name == "tactile_a with tactile_b" and "paired by" in c.text
    ]
    assert "5 frames of tactile_a and tactile_b" in check.text


def test_headers_of_two_clocks_are_not_mixed(tmp_path):
    one = [
        (START_NS + k * 10**8, raw(image, START_NS + k * 10**8)) for k, image in enumerate(draw(4))
    ]
    since_boot = [
        (START_NS + k * 10**8, raw(image, 10**9 + k * 10**8)) for k, image in enumerate(draw(4, 1))
    ]
    path = write_ros(tmp_path / "a.mcap", {"/tactile_a": one, "/tactile_b": since_boot})
    _, times, notes = read_all(path, "/tactile_b")
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert any("different clocks" in note for note in notes)


@pytest.mark.parametrize("back_ns", [10**9, 3600 * 10**9])
def test_a_clock_that_is_set_back_leaves_the_order_in_which_images_were_written(tmp_path, back_ns):
    images = draw(20)
    rows = [
        (START_NS + k * STEP_NS, raw(image, START_NS + k * STEP_NS - back_ns * (k > 9)))
        for k, image in enumerate(images)
    ]
    got, times, notes = read_all(write_ros(tmp_path / "a.mcap", {"/tactile": rows}))
    np.testing.assert_array_equal(got, images)
    assert times == pytest.approx([0.033 * k for k in range(20)])
    assert any("the clock of the headers was set back" in note for note in notes)


def test_a_wrong_checksum_is_noticed(tmp_path):
    """Of a chunk: its images are left out, the others are right.

    Of the whole file: it is refused.
    """
    images = draw(240)  # in several chunks
    rows = [(k, raw(image, START_NS + k)) for k, image in enumerate(images)]
    path = write_ros(tmp_path / "a.mcap", {"/tactile": rows}, compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    at = content.index(images[60].tobytes()) + 100
    content[at] ^= 0xFF
    path.write_bytes(bytes(content))
    got, _, notes = read_all(path)
    assert 0 < len(got) < 240
    assert all(any(np.array_equal(image, one) for one in images) for image in got)
    assert any("checksum" in note for note in select_warnings(notes))
    path = write_ros(tmp_path / "b.mcap", {"/tactile": rows[:9]}, chunked=False)
    content = bytearray(path.read_bytes())
    content[content.index(images[4].tobytes()) + 100] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(FileProblem, match="checksum does not fit"):
        open_recording(path)


def test_depth_in_a_topic_is_refused_and_not_halved_to_black(tmp_path):
    depth = np.full((24, 32), 75, np.uint16)
    png = cv2.imencode(".png", depth)[1].tobytes()
    for message in (
        compressed(png, kind="16UC1; png compressed "),
        raw(depth, encoding="16UC1"),
        raw(depth.astype(np.float32), encoding="32FC1"),
        compressed(b"\0" * 12 + png, kind="16UC1; compressedDepth png"),
    ):
        path = write_ros(tmp_path / "a.mcap", {"/bubble/depth": [(1, message)]})
        with pytest.raises(FileProblem, match="depth_mm"):
            open_recording(path)


@pytest.mark.parametrize(("encoding", "order"), [("yuv422_yuy2", (0, 1)), ("uyvy", (1, 0))])
def test_interleaved_yuv_is_read(tmp_path, encoding, order):
    image = cv2.GaussianBlur(draw(1)[0], (0, 0), 4)
    yuv = cv2.cvtColor(image, cv2.COLOR_RGB2YUV)
    pairs = np.stack(
        [
            yuv[..., 0],
            np.where(
                np.arange(32) % 2 == 0, np.roll(yuv[..., 1], 0, 1), np.roll(yuv[..., 2], 1, 1)
            ),
        ],
        -1,
    )
    got, _, _ = read_all(
        write_ros(
            tmp_path / "a.mcap", {"/tactile": [(1, raw(pairs[..., list(order)], 1, encoding))]}
        )
    )
    assert np.abs(got[0].astype(float) - image).mean() < 3.0


def test_chunks_that_state_too_much_are_not_unfolded(tmp_path):
    path = write_ros(
        tmp_path / "a.mcap", {"/tactile": [(1, raw(draw(1)[0]))]}, compression=CompressionType.NONE
    )
    content = bytearray(path.read_bytes())
    at = content.index(b"\x06", 8 + 9)  # the chunk's opcode
    content[at + 25 : at + 33] = (1 << 40).to_bytes(8, "little")
    path.write_bytes(bytes(content))
    with pytest.raises(FileProblem, match=r"1099\.5 GB"):
        open_recording(path)
