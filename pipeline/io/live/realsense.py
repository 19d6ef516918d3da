"""Live source: the depth of an Intel RealSense camera behind a bubble's membrane, with the camera's
own intrinsics and unit.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from pipeline.core.errors import CalibrationError, SettingProblem
from pipeline.core.geometry.camera import Camera
from pipeline.io.live.live_images import scale_depth
from pipeline.io.live.source import LiveFrame, LiveSourceLost
from pipeline.sensors.spec import load_sensor

_WAIT_MS = 200  # of one `read`
_SILENCE_S = 3.0  # after which a camera is opened again: one that was unplugged says nothing
_QUEUED = 2  # frames; older ones are dropped, which their numbers tell


class RealSenseSource:
    """The camera with this serial number, or the only one; `device` is one at hand."""

    touching_object = None  # not known

    def __init__(self, serial: str = "", *, sensor: str = "", device: Any = None) -> None:
        """Raises SettingProblem for a sensor that is no bubble, or without the camera's library."""
        self._spec = load_sensor(sensor or "soft_bubble")
        if not self._spec.sensor_kind.is_depth:
            raise SettingProblem(
                f"{self._spec.title} has no depth camera; give a bubble as --sensor"
            )
        try:
            import pyrealsense2
        except ImportError as error:
            raise SettingProblem(
                "a RealSense camera needs its library: install it with "
                "`pip install 'tactoscope[live]'`"
            ) from error
        self._library: Any = pyrealsense2
        self._serial = serial
        self._device = device
        self._depth_sensor: Any = None
        self._queue: Any = None
        self._last_s = 0.0  # when a frame came
        self._mm = 0.0  # of one step of its numbers
        self._camera: Camera | None = None

    @property
    def title(self) -> str:
        """Name for people."""
        return f"RealSense {self._serial}".rstrip()

    @property
    def sensor(self) -> str:
        """Name of its description."""
        return self._spec.name

    def open(self) -> None:
        """Start the camera's first depth profile; raises LiveSourceLost."""
        library = self._library
        try:
            self._depth_sensor = self._find_device().first_depth_sensor()
            profile = self._choose_profile()
            self._camera = _read_camera(profile.get_intrinsics())
            self._mm = 1e3 * self._depth_sensor.get_depth_scale()
            self._queue = library.frame_queue(_QUEUED)
            self._depth_sensor.open(profile)
            self._depth_sensor.start(self._queue)
            self._last_s = time.monotonic()
        except RuntimeError as error:
            raise LiveSourceLost(f"the camera cannot be started ({error})") from error

    def _find_device(self) -> Any:
        if self._device is not None:
            return self._device
        name = self._library.camera_info.serial_number
        devices = list(self._library.context().query_devices())
        found = [one for one in devices if self._serial in ("", one.get_info(name))]
        if len(found) == 1:
            return found[0]
        there = ", ".join(one.get_info(name) for one in devices) or "none"
        raise LiveSourceLost(f"connected RealSense cameras: {there}; choose one by its number")

    def _choose_profile(self) -> Any:
        """Return the default depth profile, or the first."""
        depth = [
            one.as_video_stream_profile()
            for one in self._depth_sensor.get_stream_profiles()
            if one.format() == self._library.format.z16
        ]
        if not depth:
            raise LiveSourceLost("the camera has no depth stream")
        return next((one for one in depth if one.is_default()), depth[0])

    def read(self) -> LiveFrame | None:
        """Return the next depth in mm, NaN where there is none."""
        try:
            came, frame = self._queue.try_wait_for_frame(_WAIT_MS)
        except RuntimeError as error:
            raise LiveSourceLost(f"the camera was lost ({error})") from error
        if not came:
            if time.monotonic() - self._last_s > _SILENCE_S:
                raise LiveSourceLost(
                    f"no depth has come for {_SILENCE_S:g} s; check the camera's cable"
                )
            return None
        self._last_s = time.monotonic()
        return LiveFrame(
            image=scale_depth(np.asarray(frame.as_depth_frame().get_data()), self._mm),
            time_s=self._last_s,
            sequence_number=frame.get_frame_number(),
            stamp_s=1e-3 * frame.get_timestamp(),
            camera=self._camera,
        )

    def close(self) -> None:
        """Stop the camera; may be opened again."""
        if self._depth_sensor is not None:
            try:
                self._depth_sensor.stop()
                self._depth_sensor.close()
            except RuntimeError:
                pass  # it is gone
            self._depth_sensor = None


def _read_camera(found: Any) -> Camera:
    """Return the intrinsics of a depth stream; raises CalibrationError for a distorted one."""
    if any(found.coeffs):
        raise CalibrationError(
            "the camera's depth has lens distortion; use one whose depth is rectified (D400)"
        )
    return Camera(
        rows=found.height,
        cols=found.width,
        fx_px=found.fx,
        fy_px=found.fy,
        cx_px=found.ppx,
        cy_px=found.ppy,
    )
