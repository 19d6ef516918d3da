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
from pipeline.live.source import Reading, SourceLost
from pipeline.recordings.gel_pictures import GelPictures, gel_pictures

BY_ID = Path("/dev/v4l/by-id")
_NODE = re.compile(r"(?:usb-)?(?P<name>.+)-video-index0")  # the second node of a camera holds no pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """How a kind of camera is set."""

    sensor: str
    words: str  # in its name
    size_px: tuple[int, int]  # width, height as it is asked for
    rate_hz: float
    turned: bool = False  # transposed and put upside down, as DIGIT's own driver does
    light: int = -1  # of CAP_PROP_ZOOM, which carries DIGIT's light of 0 to 15 a colour; -1 = as it is


_FULL_LIGHT = 15 << 8 | 15 << 4 | 15
KINDS = (  # digit-interface: QVGA at 60; gsrobotics: the whole camera at 25, a seventh cut off each side
    Kind(sensor="digit", words="digit", size_px=(320, 240), rate_hz=60.0, turned=True, light=_FULL_LIGHT),
    Kind(sensor="gelsight_mini", words="gelsight", size_px=(3280, 2464), rate_hz=25.0),
)
_ANY = Kind(sensor="", words="", size_px=(0, 0), rate_hz=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A camera that is plugged in."""

    name: str  # with its serial number, as the system tells it
    node: Path
    kind: Kind


def found(by_id: Path = BY_ID) -> tuple[Found, ...]:
    """The cameras of this machine, those of known sensors first."""
    cameras: list[Found] = []
    for node in sorted(by_id.glob("*")) if by_id.is_dir() else ():
        told = _NODE.fullmatch(node.name)
        if told is not None:
            cameras.append(Found(name=told["name"], node=node, kind=_kind(told["name"])))
    return tuple(sorted(cameras, key=lambda camera: camera.kind is _ANY))


def capture(node: Path, kind: Kind) -> Any:
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
    if kind.light >= 0:
        taken.set(cv2.CAP_PROP_ZOOM, kind.light)
    return taken


class Device:
    """A camera by a part of its name or its serial, or by a path; found again wherever it is plugged in."""

    def __init__(
        self,
        wanted: str,
        *,
        sensor: str = "",
        by_id: Path = BY_ID,
        opened: Callable[[Path, Kind], Any] = capture,
    ) -> None:
        self._wanted, self._said, self._by_id, self._open = wanted, sensor, by_id, opened
        self._kind = _kind(wanted) if not sensor else next((k for k in KINDS if k.sensor == sensor), _ANY)
        self._capture: Any = None
        self._made: GelPictures | None = None
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
    def touched(self) -> None:
        """Nobody knows."""

    def open(self) -> None:
        """Look for it by name and begin; raises SourceLost where it is not there or does not answer."""
        node = self._node()
        self._capture = self._open(node, self._kind)
        if not self._capture.isOpened():
            self.close()
            raise SourceLost(f"{self._wanted!r} is there but cannot be opened; does another program use it?")

    def read(self) -> Reading | None:
        """The next picture as the sensor's own driver gives it; raises SourceLost where none comes any more."""
        there, raw = self._capture.read()
        if not there or raw is None:
            raise SourceLost(f"no picture comes from {self._wanted!r} any more; is it plugged in?")
        return Reading(image=self._picture(np.asarray(raw)), time_s=time.monotonic())

    def close(self) -> None:
        """Let go of the camera."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _node(self) -> Path:
        path = Path(self._wanted)
        if path.is_absolute() or path.exists():
            if not path.exists():
                raise SourceLost(f"there is no '{path}'; it is looked for again")
            return path
        cameras = found(self._by_id)
        for camera in cameras:
            if self._wanted.lower() in camera.name.lower():
                self._kind = self._kind if self._said else camera.kind
                return camera.node
        known = ", ".join(camera.name for camera in cameras) or "none"
        raise SourceLost(f"no camera named {self._wanted!r} is plugged in; there are: {known}")

    def _picture(self, bgr: np.ndarray) -> Image:
        rgb = bgr[:, :, ::-1] if bgr.ndim == 3 else np.repeat(bgr[:, :, None], 3, axis=2)
        if self._kind.turned:
            rgb = np.flipud(np.swapaxes(rgb, 0, 1))
        rgb = np.ascontiguousarray(rgb)
        if self._made is None or rgb.shape != self._shape:
            self._made = gel_pictures(self.sensor, (rgb.shape[0], rgb.shape[1]), rgb, lambda: rgb)
            self._shape = rgb.shape
            if not self._made.sensor:
                size = f"{rgb.shape[1]} x {rgb.shape[0]} px"
                raise SettingProblem(f"which sensor takes pictures of {size}? say it with --sensor")
        return self._made.picture(rgb)


def _kind(name: str) -> Kind:
    return next((kind for kind in KINDS if kind.words in name.lower()), _ANY)
