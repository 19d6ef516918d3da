"""Live source: cameras and video streams of a network.

USB cameras such as DIGIT and GelSight Mini are read as their own drivers read them.
"""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.arrays import Image
from pipeline.core.frozen import frozen
from pipeline.core.native_stderr import silence_native_libraries
from pipeline.io.live.live_images import LiveImages
from pipeline.io.live.source import LiveFrame, LiveSourceLost

CAMERAS_BY_ID = Path("/dev/v4l/by-id")
_ADDRESSES = ("http://", "https://", "rtsp://", "rtsps://")
_NODE = re.compile(r"(?:usb-)?(?P<name>.+)-video-index0")  # index1 is a metadata node


@frozen
class UsbCameraProfile:
    """Camera settings of one kind of sensor."""

    sensor: str
    name_substring: str  # of the camera's name, lower case
    size_px: tuple[int, int]  # requested width and height; 0 = as it is
    rate_hz: float
    is_rotated: bool = False  # transposed and flipped vertically, as DIGIT's driver does
    # CAP_PROP_ZOOM, DIGIT's LED intensity of 0 to 15 per colour; -1 = as it is
    led_setting: int = -1


# without an answer of a network stream
_OPEN_MS = 3000
_READ_MS = 2000
_FULL_INTENSITY = 15 << 8 | 15 << 4 | 15
# digit-interface: QVGA at 60 Hz; gsrobotics: full image at 25 Hz, cropped by a seventh
USB_CAMERA_PROFILES = (
    UsbCameraProfile(
        sensor="digit",
        name_substring="digit",
        size_px=(320, 240),
        rate_hz=60.0,
        is_rotated=True,
        led_setting=_FULL_INTENSITY,
    ),
    UsbCameraProfile(
        sensor="gelsight_mini", name_substring="gelsight", size_px=(3280, 2464), rate_hz=25.0
    ),
)
_UNKNOWN = UsbCameraProfile(sensor="", name_substring="", size_px=(0, 0), rate_hz=0.0)


@frozen
class UsbCamera:
    """A connected camera."""

    name: str  # with serial number, as the system lists it
    node: Path
    profile: UsbCameraProfile


def list_usb_cameras(by_id: Path = CAMERAS_BY_ID) -> tuple[UsbCamera, ...]:
    """The connected cameras, those of known sensors first."""
    cameras: list[UsbCamera] = []
    for node in sorted(by_id.glob("*")) if by_id.is_dir() else ():
        match = _NODE.fullmatch(node.name)
        if match is not None:
            cameras.append(
                UsbCamera(name=match["name"], node=node, profile=_find_profile(match["name"]))
            )
    return tuple(sorted(cameras, key=lambda camera: camera.profile is _UNKNOWN))


def open_capture(node: Path | str, profile: UsbCameraProfile) -> Any:
    """OpenCV's capture of a camera with the settings of `profile`, of a recorded stream, or of a
    network address.
    """
    import cv2

    if isinstance(node, str):
        limits = [
            cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
            _OPEN_MS,
            cv2.CAP_PROP_READ_TIMEOUT_MSEC,
            _READ_MS,
        ]
        with silence_native_libraries():
            return cv2.VideoCapture(node, cv2.CAP_FFMPEG, limits)
    if not node.is_char_device():
        return cv2.VideoCapture(str(node))
    capture: Any = cv2.VideoCapture(str(node.resolve()), cv2.CAP_V4L2)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest image, not one of a queue
    if profile.size_px[0]:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, profile.size_px[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, profile.size_px[1])
        capture.set(cv2.CAP_PROP_FPS, profile.rate_hz)
    if profile.led_setting >= 0:
        capture.set(cv2.CAP_PROP_ZOOM, profile.led_setting)
    return capture


class UsbCameraSource:
    """A camera by its number, by a part of its name or serial number, or by a path or network
    address.

    After a loss a named camera is searched on every port.
    """

    touching_object = None  # not known

    def __init__(
        self,
        name_or_path: str,
        *,
        sensor: str = "",
        by_id: Path = CAMERAS_BY_ID,
        opener: Callable[[Path | str, UsbCameraProfile], Any] = open_capture,
    ) -> None:
        self._name = name_or_path
        self._sensor = sensor
        self._by_id = by_id
        self._open = opener
        of_sensor = next((p for p in USB_CAMERA_PROFILES if p.sensor == sensor), _UNKNOWN)
        self._profile = of_sensor if sensor else _find_profile(name_or_path)
        self._capture: Any = None
        self._images = LiveImages(sensor or self._profile.sensor)

    @property
    def title(self) -> str:
        """Name for people."""
        return f"camera {self._name}" if self._name.isdecimal() else self._name

    @property
    def sensor(self) -> str:
        """The sensor as stated, else by the camera's name, else by the image size."""
        return self._images.sensor

    def open(self) -> None:
        """Find the camera and open it; raises LiveSourceLost."""
        node = self._find_node()
        self._capture = self._open(node, self._profile)
        if not self._capture.isOpened():
            self.close()
            remedy = (
                "check address and network"
                if isinstance(node, str)
                else "close other programs that use it"
            )
            raise LiveSourceLost(f"{self._name!r} cannot be opened; {remedy}")

    def read(self) -> LiveFrame | None:
        """The next image as the sensor's driver gives it; raises LiveSourceLost."""
        ok, raw = self._capture.read()
        if not ok or raw is None:
            at = "network" if is_address(self._name) else "cable"
            raise LiveSourceLost(f"no image comes from {self._name!r}; check the {at}")
        return LiveFrame(image=self._convert_image(np.asarray(raw)), time_s=time.monotonic())

    def close(self) -> None:
        """Release the camera."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _find_node(self) -> Path | str:
        if is_address(self._name):
            return self._name
        path = Path(f"/dev/video{self._name}" if self._name.isdecimal() else self._name)
        if path.is_absolute() or path.exists():
            if not path.exists():
                raise LiveSourceLost(f"there is no '{path}'; connect it, or name one of --list")
            return path
        cameras = list_usb_cameras(self._by_id)
        for camera in cameras:
            if self._name.lower() in camera.name.lower():
                if not self._sensor:
                    self._profile = camera.profile
                    self._images = LiveImages(camera.profile.sensor)
                return camera.node
        known = ", ".join(camera.name for camera in cameras) or "none"
        raise LiveSourceLost(f"no camera named {self._name!r} is connected; there are: {known}")

    def _convert_image(self, bgr: np.ndarray) -> Image:
        rgb = bgr[:, :, ::-1] if bgr.ndim == 3 else np.repeat(bgr[:, :, None], 3, axis=2)
        if self._profile.is_rotated:
            rgb = np.flipud(np.swapaxes(rgb, 0, 1))
        rgb = np.ascontiguousarray(rgb)
        return self._images.convert_image(rgb)


def is_address(name: str) -> bool:
    """Whether a camera is named by a network address that OpenCV can open."""
    return name.startswith(_ADDRESSES)


def _find_profile(name: str) -> UsbCameraProfile:
    return next((p for p in USB_CAMERA_PROFILES if p.name_substring in name.lower()), _UNKNOWN)
