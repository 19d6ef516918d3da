"""Sensors on a network: video streams over HTTP, and the topics of a real Foxglove server."""

from __future__ import annotations

import time
from contextlib import closing

import cv2
import foxglove
import numpy as np
import pytest
from foxglove.channels import CameraCalibrationChannel, CompressedImageChannel, RawImageChannel
from foxglove.messages import CameraCalibration, CompressedImage, Timestamp
from mcap_ros2._dynamic import serialize_dynamic

from pipeline.core.errors import CalibrationError, SettingProblem
from pipeline.io.live.reader import LiveReader
from pipeline.io.live.source import LiveFrame, LiveSourceLost
from pipeline.io.live.source_parsing import parse_source
from pipeline.sensors.spec import load_sensor
from tests.pipeline.io.live.streams import make_coloured, make_raw, publishing, serve_mjpeg

LIMIT_S = 30.0
GELSLIM = load_sensor("gelslim")
BUBBLE = load_sensor("soft_bubble")
ROS_IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def read_frame(source, wanted=lambda frame: True) -> LiveFrame:
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        frame = source.read()
        if frame is not None and wanted(frame):
            return frame
    raise AssertionError("no frame came in time")


def test_a_video_stream_over_http_gives_its_images():
    image = make_coloured(GELSLIM.camera.shape, 120)
    with serve_mjpeg([image]) as (address, ended):
        source = parse_source([address], sensor="gelslim")
        with closing(source):
            source.open()
            frame = read_frame(source)
            assert source.sensor == "gelslim"
            assert frame.image.shape == image.shape
            assert np.abs(frame.image.astype(int) - image).mean() < 6.0
            ended.set()
            with pytest.raises(LiveSourceLost, match="check the network"):
                read_frame(source, lambda _: False)


def test_a_stream_that_dies_is_tried_again_and_numbering_goes_on():
    with serve_mjpeg([make_coloured(GELSLIM.camera.shape, 120)]) as (address, ended):
        reader = LiveReader(parse_source([address], sensor="gelslim"))
        reader.start()
        end_s = time.monotonic() + LIMIT_S
        while reader.n_frames < 3:
            assert time.monotonic() < end_s
            time.sleep(0.01)
        ended.set()
        while reader.status().state != "lost":
            assert time.monotonic() < end_s
            time.sleep(0.01)
        n = reader.n_frames
        ended.clear()
        while reader.n_frames < n + 3:
            assert time.monotonic() < end_s
            time.sleep(0.01)
        assert reader.frame(n).index == n
        assert reader.stop(LIMIT_S)


def test_an_address_without_a_stream_is_a_loss():
    source = parse_source(["http://127.0.0.1:9/none"], sensor="gelslim")
    with pytest.raises(LiveSourceLost, match="check address and network"):
        source.open()


@pytest.fixture
def bridge():
    """A running Foxglove server on a free port: (address, context for its channels)."""
    context = foxglove.Context()
    server = foxglove.start_server(host="127.0.0.1", port=0, context=context)
    yield f"ws://127.0.0.1:{server.port}", context
    server.stop()


def test_raw_and_compressed_images_of_a_bridge_are_read(bridge):
    address, context = bridge
    image = make_coloured(GELSLIM.camera.shape, 140)
    raw = RawImageChannel("/gelslim/image", context=context)
    packed = CompressedImageChannel("/gelslim/compressed", context=context)
    png = cv2.imencode(".png", image[:, :, ::-1])[1].tobytes()

    def publish(n):
        raw.log(make_raw(image, "rgb8", 100.0 + n))
        packed.log(CompressedImage(timestamp=Timestamp(sec=100 + n), data=png, format="png"))

    with publishing(publish):
        for topic in ("/gelslim/image", "gelslim/compressed"):
            with closing(parse_source([f"{address} {topic}"])) as source:
                source.open()
                frame = read_frame(source)
                assert source.sensor == "gelslim"
                np.testing.assert_array_equal(frame.image, image)
                assert frame.stamp_s == int(frame.stamp_s) >= 100


def test_images_of_ros_2_are_read_by_their_message_definition(bridge):
    address, context = bridge
    image = make_coloured(GELSLIM.camera.shape, 99)
    schema = foxglove.Schema(
        name="sensor_msgs/msg/Image", encoding="ros2msg", data=ROS_IMAGE.encode()
    )
    channel = foxglove.Channel("/cam", schema=schema, message_encoding="cdr", context=context)
    encode = serialize_dynamic("sensor_msgs/msg/Image", ROS_IMAGE)["sensor_msgs/msg/Image"]
    rows, cols = image.shape[:2]
    bgr = np.ascontiguousarray(image[:, :, ::-1])
    told = {
        "header": {"stamp": {"sec": 7, "nanosec": 500_000_000}, "frame_id": ""},
        "height": rows,
        "width": cols,
        "encoding": "bgr8",
        "is_bigendian": 0,
        "step": 3 * cols,
        "data": bgr.tobytes(),
    }
    content = bytes(encode(told))
    with (
        publishing(lambda _: channel.log(content)),
        closing(parse_source([address], sensor="gelslim")) as source,
    ):
        source.open()
        frame = read_frame(source)
        np.testing.assert_array_equal(frame.image, image)
        assert frame.stamp_s == 7.5


@pytest.mark.parametrize(
    ("encoding", "kind", "per_mm"), [("16UC1", np.uint16, 1.0), ("32FC1", np.float32, 1e-3)]
)
def test_depth_topics_are_a_bubble_in_mm_with_the_published_camera(bridge, encoding, kind, per_mm):
    address, context = bridge
    spec = BUBBLE
    depth = np.rint(spec.rest_depth_mm)
    raw = (depth * per_mm).astype(kind)
    raw[0, 0] = 0
    images = RawImageChannel("/bubble/image", context=context)
    cameras = CameraCalibrationChannel("/bubble/camera_info", context=context)
    rows, cols = raw.shape
    k = [250.0, 0.0, cols / 2, 0.0, 251.0, rows / 2, 0.0, 0.0, 1.0]

    def publish(n):
        cameras.log(CameraCalibration(width=cols, height=rows, K=k))
        images.log(make_raw(raw, encoding, 100.0 + n))

    with publishing(publish), closing(parse_source([address], sensor="soft_bubble")) as source:
        source.open()
        frame = read_frame(source, lambda frame: frame.camera is not None)
        assert np.isnan(frame.image[0, 0])
        np.testing.assert_allclose(frame.image[1:], depth[1:], atol=1e-3)
        assert (frame.camera.fx_px, frame.camera.fy_px) == (250.0, 251.0)


@pytest.mark.parametrize("focal_px", [0.0, -250.0])
def test_a_camera_that_is_not_calibrated_is_not_used_and_an_impossible_one_is_said(
    bridge, focal_px
):
    address, context = bridge
    raw = np.rint(BUBBLE.rest_depth_mm).astype(np.uint16)
    images = RawImageChannel("/bubble/image", context=context)
    cameras = CameraCalibrationChannel("/bubble/camera_info", context=context)
    rows, cols = raw.shape
    k = [focal_px, 0.0, cols / 2, 0.0, focal_px, rows / 2, 0.0, 0.0, 1.0]

    def publish(n):
        cameras.log(CameraCalibration(width=cols, height=rows, K=k))
        images.log(make_raw(raw, "16UC1", 100.0 + n))

    source = parse_source([address], sensor="soft_bubble")
    with publishing(publish), closing(source):
        source.open()
        if focal_px:
            with pytest.raises(CalibrationError, match="must be positive"):
                read_frame(source, lambda _: False)
        else:
            assert all(read_frame(source).camera is None for _ in range(5))


def test_topics_are_listed_where_none_or_another_is_named(bridge):
    address, context = bridge
    for name in ("/left/image", "/right/image"):
        RawImageChannel(name, context=context)
    for words in ([address], [address, "/middle"]):
        with (
            closing(parse_source(words)) as source,
            pytest.raises(LiveSourceLost, match=r"/left/image, /right/image"),
        ):
            source.open()


def test_a_port_without_a_bridge_is_a_loss():
    with pytest.raises(LiveSourceLost, match="no Foxglove bridge answers"):
        parse_source(["ws://127.0.0.1:9"]).open()


class Scripted:
    """A sensor that gives these frames, then nothing."""

    title = "scripted"
    sensor = "digit"
    touching_object = None

    def __init__(self, frames):
        self.frames = list(frames)

    def open(self):
        pass

    def read(self):
        time.sleep(0.001)
        return self.frames.pop(0) if self.frames else None

    def close(self):
        pass


def test_frames_that_came_twice_and_jumps_of_the_sensors_clock_are_counted():
    image = np.zeros((*load_sensor("digit").camera.shape, 3), np.uint8)
    stamps_s = (5.0, 5.03, 5.03, 5.06, 3605.0, 3605.03, 10.0)
    source = Scripted(
        LiveFrame(image=image, time_s=0.03 * k, sequence_number=k, stamp_s=s)
        for k, s in enumerate(stamps_s)
    )
    reader = LiveReader(source)
    reader.start()
    end_s = time.monotonic() + LIMIT_S
    while reader.n_frames < len(stamps_s):
        assert time.monotonic() < end_s
        time.sleep(0.005)
    status = reader.status()
    reader.stop(LIMIT_S)
    assert (status.n_doubled, status.n_clock_jumps, status.n_lost) == (1, 2, 0)


@pytest.mark.parametrize("words", [["camera:"], ["ws://a", "b", "c"], ["ftp://a"]])
def test_other_addresses_are_refused_with_what_there_is(words):
    with pytest.raises(SettingProblem, match=r"a source is simulated.*ws://HOST:PORT TOPIC"):
        parse_source(words)
