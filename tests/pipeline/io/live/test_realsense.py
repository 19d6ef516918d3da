"""A RealSense camera, by the software device of its own library."""

import numpy as np
import pyrealsense2 as rs
import pytest

from pipeline.core.errors import CalibrationError, SettingProblem
from pipeline.io.live.realsense import RealSenseSource
from pipeline.io.live.source import LiveSourceLost
from pipeline.io.live.source_parsing import parse_source

ROWS, COLS = 48, 64
UNIT_M = 1e-4


class SoftCamera:
    """A camera whose frames the test makes."""

    def __init__(self, coefficients=(0.0,) * 5) -> None:
        self.device = rs.software_device()
        self._sensor = self.device.add_sensor("Depth")
        lens = rs.intrinsics()
        lens.width, lens.height, lens.model = COLS, ROWS, rs.distortion.brown_conrady
        lens.fx, lens.fy, lens.ppx, lens.ppy = 50.0, 51.0, 31.5, 23.5
        lens.coeffs = list(coefficients)
        stream = rs.video_stream()
        stream.type, stream.fmt, stream.bpp, stream.fps = rs.stream.depth, rs.format.z16, 2, 30
        stream.width, stream.height, stream.uid, stream.intrinsics = COLS, ROWS, 1, lens
        self._profile = self._sensor.add_video_stream(stream).as_video_stream_profile()
        self._sensor.add_read_only_option(rs.option.depth_units, UNIT_M)

    def send(self, depth, number, ms) -> None:
        frame = rs.software_video_frame()
        frame.pixels, frame.bpp, frame.stride = depth, 2, 2 * COLS
        frame.timestamp, frame.frame_number, frame.profile = ms, number, self._profile
        frame.domain = rs.timestamp_domain.hardware_clock
        self._sensor.on_video_frame(frame)


def test_depth_has_the_camera_s_unit_intrinsics_number_and_stamp():
    camera = SoftCamera()
    source = RealSenseSource(device=camera.device)
    source.open()
    try:
        depth = np.full((ROWS, COLS), 700, np.uint16)
        depth[3, 5] = 0
        camera.send(depth, 7, 1500.0)
        frame = source.read()
        assert frame.image[0, 0] == pytest.approx(70.0)
        assert np.isnan(frame.image[3, 5])
        assert np.isnan(frame.image).sum() == 1
        assert (frame.sequence_number, frame.stamp_s) == (7, pytest.approx(1.5))
        assert frame.camera.shape == (ROWS, COLS)
        assert (frame.camera.fy_px, frame.camera.cx_px) == pytest.approx((51.0, 31.5))
        assert source.read() is None, "nothing more"
    finally:
        source.close()


def test_a_camera_may_be_opened_again():
    camera = SoftCamera()
    source = RealSenseSource(device=camera.device)
    for number in (1, 2):
        source.open()
        camera.send(np.full((ROWS, COLS), 500, np.uint16), number, 1.0)
        assert source.read().sequence_number == number
        source.close()


def test_a_distorted_depth_is_refused():
    source = RealSenseSource(device=SoftCamera((0.1, 0.0, 0.0, 0.0, 0.0)).device)
    with pytest.raises(CalibrationError, match="lens distortion"):
        source.open()


def test_no_camera_is_a_lost_one_and_says_what_is_there():
    source = parse_source(["realsense", "1234"])
    assert source.sensor == "soft_bubble"
    assert source.title == "RealSense 1234"
    with pytest.raises(LiveSourceLost, match="connected RealSense cameras: none"):
        source.open()


def test_a_gel_has_no_depth_camera():
    with pytest.raises(SettingProblem, match="has no depth camera"):
        parse_source(["realsense"], sensor="gelslim")
