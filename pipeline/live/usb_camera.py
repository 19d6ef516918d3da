"""Sensors that are USB cameras: DIGIT and GelSight Mini by name and serial, read as their own drivers read them."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.arrays import Image
from pipeline.base.errors import SettingProblem
from pipeline.live.source import LiveFrame, LiveSourceLost
from pipeline.recordings.gel_images import GelImageConverter, make_gel_converter

CAMERAS_BY_ID = Path("/dev/v4l/by-id")
_NODE = re.compile(r"(?:usb-)?(?P<name>.+)-video-index0")  # the second node of a camera holds no pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class UsbCameraProfile:
    """How a kind of camera is set."""

    sensor: str
    name_substring: str  # in its name
    size_px: tuple[int, int]  # width, height as it is asked for
    rate_hz: float
    is_rotated: bool = False  # transposed and put upside down, as DIGIT's own driver does
    led_setting: int = -1  # of CAP_PROP_ZOOM, which carries DIGIT's light of 0 to 15 a colour; -1 = as it is


_FULL_LIGHT = 15 << 8 | 15 << 4 | 15
USB_CAMERA_PROFILES = (  # digit-interface: QVGA at 60; gsrobotics: the whole camera at 25, a seventh cut off each side
    UsbCameraProfile(
        sensor="digit",
        name_substring="digit",
        size_px=(320, 240),
        rate_hz=60.0,
        is_rotated=True,
        led_setting=_FULL_LIGHT,
    ),
    UsbCameraProfile(sensor="gelsight_mini", name_substring="gelsight", size_px=(3280, 2464), rate_hz=25.0),
)
_ANY = UsbCameraProfile(sensor="", name_substring="", size_px=(0, 0), rate_hz=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class UsbCamera:
    """A camera that is plugged in."""

    name: str  # with its serial number, as the system tells it
    node: Path
    profile: UsbCameraProfile


def list_usb_cameras(by_id: Path = CAMERAS_BY_ID) -> tuple[UsbCamera, ...]:
    """The cameras of this machine, those of known sensors first."""
    cameras: list[UsbCamera] = []
    for node in sorted(by_id.glob("*")) if by_id.is_dir() else ():
        told = _NODE.fullmatch(node.name)
        if told is not None:
            cameras.append(UsbCamera(name=told["name"], node=node, profile=_kind(told["name"])))
    return tuple(sorted(cameras, key=lambda camera: camera.profile is _ANY))


def open_capture(node: Path, kind: UsbCameraProfile) -> Any:
    """OpenCV's reader of a camera, set as its kind wants it, or of a recorded stream."""
    import cv2

    if not node.is_char_device():
        return cv2.VideoCapture(str(node))
    taken: Any = cv2.VideoCapture(str(node.resolve()), cv2.CAP_V4L2)
    taken.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, not one of a queue
    if kind.size_px[0]:
        taken.set(cv2.CAP_PROP_FRAME_WIDTH, kind.size_px[0])
        taken.set(cv2.CAP_PROP_FRAME_HEIGHT, kind.size_px[1])
        taken.set(cv2.CAP_PROP_FPS, kind.rate_hz)
    if kind.led_setting >= 0:
        taken.set(cv2.CAP_PROP_ZOOM, kind.led_setting)
    return taken


class UsbCameraSource:
    """A camera by a part of its name or its serial, or by a path; found again wherever it is plugged in."""

    def __init__(
        self,
        wanted: str,
        *,
        sensor: str = "",
        by_id: Path = CAMERAS_BY_ID,
        opener: Callable[[Path, UsbCameraProfile], Any] = open_capture,
    ) -> None:
        self._wanted, self._said, self._by_id, self._open = wanted, sensor, by_id, opener
        self._kind = _kind(wanted) if not sensor else next((k for k in USB_CAMERA_PROFILES if k.sensor == sensor), _ANY)
        self._capture: Any = None
        self._made: GelImageConverter | None = None
        self._shape: tuple[int, ...] = ()

    @property
    def title(self) -> str:
        """What it is, in words."""
        return self._wanted

    @property
    def sensor(self) -> str:
        """The sensor that was said, that its name tells, or the size of its pictures."""
        return self._said or self._kind.sensor or (self._made.sensor if self._made is not None else "")

    @property
    def touching_object(self) -> None:
        """Nobody knows."""

    def open(self) -> None:
        """Look for it by name and begin; raises SourceLost where it is not there or does not answer."""
        node = self._node()
        self._capture = self._open(node, self._kind)
        if not self._capture.isOpened():
            self.close()
            raise LiveSourceLost(f"{self._wanted!r} is there but cannot be opened; does another program use it?")

    def read(self) -> LiveFrame | None:
        """The next picture as the sensor's own driver gives it; raises SourceLost where none comes any more."""
        there, raw = self._capture.read()
        if not there or raw is None:
            raise LiveSourceLost(f"no picture comes from {self._wanted!r} any more; is it plugged in?")
        return LiveFrame(image=self._picture(np.asarray(raw)), time_s=time.monotonic())

    def close(self) -> None:
        """Let go of the camera."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _node(self) -> Path:
        path = Path(self._wanted)
        if path.is_absolute() or path.exists():
            if not path.exists():
                raise LiveSourceLost(f"there is no '{path}'; it is looked for again")
            return path
        cameras = list_usb_cameras(self._by_id)
        for camera in cameras:
            if self._wanted.lower() in camera.name.lower():
                self._kind = self._kind if self._said else camera.profile
                return camera.node
        known = ", ".join(camera.name for camera in cameras) or "none"
        raise LiveSourceLost(f"no camera named {self._wanted!r} is plugged in; there are: {known}")

    def _picture(self, bgr: np.ndarray) -> Image:
        rgb = bgr[:, :, ::-1] if bgr.ndim == 3 else np.repeat(bgr[:, :, None], 3, axis=2)
        if self._kind.is_rotated:
            rgb = np.flipud(np.swapaxes(rgb, 0, 1))
        rgb = np.ascontiguousarray(rgb)
        if self._made is None or rgb.shape != self._shape:
            self._made = make_gel_converter(self.sensor, (rgb.shape[0], rgb.shape[1]), rgb, lambda: rgb)
            self._shape = rgb.shape
            if not self._made.sensor:
                size = f"{rgb.shape[1]} x {rgb.shape[0]} px"
                raise SettingProblem(f"which sensor takes pictures of {size}? say it with --sensor")
        return self._made.convert_image(rgb)


def _kind(name: str) -> UsbCameraProfile:
    return next((kind for kind in USB_CAMERA_PROFILES if kind.name_substring in name.lower()), _ANY)
