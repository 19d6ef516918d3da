"""Live source: images and depth that a Foxglove bridge publishes, of ROS 1 and 2 or of any program,
without ROS.

The protocol is foxglove.websocket.v1 (github.com/foxglove/ws-protocol): the server lists its
channels as JSON, the client subscribes by their ids, and messages come as binary frames.
"""

import base64
import json
import math
import struct
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import numpy as np

from pipeline.core.arrays import Floats, Image
from pipeline.core.errors import FileProblem, SettingProblem, TouchError, escape_text
from pipeline.core.frozen import frozen
from pipeline.core.geometry.camera import Camera
from pipeline.io.live.live_images import LiveImages, scale_depth
from pipeline.io.live.source import LiveFrame, LiveSourceLost
from pipeline.io.mcap_images import (
    IMAGE_SCHEMAS,
    Decoders,
    decode_image,
    make_decoders,
    read_stamp_ns,
)
from pipeline.io.mcap_records import McapChannel

_PROTOCOLS: Any = ("foxglove.websocket.v1", "foxglove.sdk.v1")
_CAMERA_SCHEMAS = frozenset({"foxglove.CameraCalibration", "sensor_msgs/msg/CameraInfo"})
_MESSAGE = struct.Struct("<BIQ")  # kind, subscription, time of sending in ns
_MESSAGE_DATA = 1
# of our subscriptions
_N_INTRINSICS = 9  # of K, row by row
_IMAGE_ID = 1
_CAMERA_ID = 2
_LIST_S = 3.0  # for the channels of a server to be listed
_WAIT_S = 0.2  # of one `read`
_PING_S = 3.0  # between signs of life, and without one: a cable pulled out says nothing
_MAX_BYTES = 1 << 27  # of one message
# type and mm (REP 118)
_DEPTH = {"16UC1": (np.uint16, 1.0), "mono16": (np.uint16, 1.0), "32FC1": (np.float32, 1e3)}
_PNG = b"\x89PNG"


@frozen
class _Channel:
    """A topic of the server, as the decoders of messages know it."""

    id: int
    mcap: McapChannel

    @property
    def schema(self) -> str:
        """Name of its type, in the spelling of ROS 2."""
        name = "" if self.mcap.schema is None else self.mcap.schema.name
        return name if "/msg/" in name or "/" not in name else name.replace("/", "/msg/")


class FoxgloveSource:
    """One topic of images or depth; without a name the only one that there is."""

    touching_object = None  # not known

    def __init__(self, address: str, topic: str = "", *, sensor: str = "") -> None:
        self._address = address
        self._topic = topic
        self._images = LiveImages(sensor, file_names=(topic,))
        self._link: Any = None
        self._open = ExitStack()
        self._decoders: Decoders | None = None
        self._channels: dict[int, _Channel] = {}
        self._image: _Channel | None = None
        self._camera: Camera | None = None
        self._camera_channel: _Channel | None = None

    @property
    def title(self) -> str:
        """Name for people."""
        return escape_text(f"{self._address} {self._topic}".strip())

    @property
    def sensor(self) -> str:
        """The stated sensor, or the one guessed from topic and size; "" before the first image."""
        return self._images.sensor

    def open(self) -> None:
        """Connect and subscribe; raises LiveSourceLost, and SettingProblem where a package is
        missing.
        """
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ImportError as error:
            raise SettingProblem(
                "a Foxglove bridge is read by websockets; pip install tactoscope[live]"
            ) from error
        if self._decoders is None:
            self._decoders = make_decoders()
        self._channels = {}
        self._image = None
        self._camera = None
        self._camera_channel = None
        try:
            link: Any = connect(
                self._address,
                subprotocols=_PROTOCOLS,
                open_timeout=_LIST_S,
                max_size=_MAX_BYTES,
                compression=None,
                close_timeout=1.0,
                ping_interval=_PING_S,
                ping_timeout=_PING_S,
            )
            self._link = self._open.enter_context(link)
        except (OSError, WebSocketException, ValueError) as error:
            self.close()
            why = escape_text(str(error)[:120].strip()) or type(error).__name__
            raise LiveSourceLost(
                f"no Foxglove bridge answers at '{self.title}' ({why}); check host and port"
            ) from None
        end_s = time.monotonic() + _LIST_S
        while self._image is None and time.monotonic() < end_s:
            self._receive(_WAIT_S)
        if self._image is None:
            raise LiveSourceLost(self._describe_topics())

    def read(self) -> LiveFrame | None:
        """The next image in the order of arrival; raises LiveSourceLost."""
        content = self._receive(_WAIT_S)
        if content is None or self._image is None or self._decoders is None:
            return None
        channel = self._image.mcap
        where = f"an image of {escape_text(self._topic)}"
        now_s = time.monotonic()
        try:
            message = self._decoders.decode(channel, content)
            stamp_ns = read_stamp_ns(channel, content, self._decoders)
            image = (
                _unpack_depth(message)
                if _holds_depth(message)
                else decode_image(message, where, Path(self._topic))
            )
        except TouchError:
            raise
        except Exception as error:  # noqa: BLE001 - a border: what decoders raise at foreign bytes
            raise LiveSourceLost(f"{where} cannot be decoded ({type(error).__name__})") from None
        stamp_s = stamp_ns / 1e9 if stamp_ns else math.nan
        camera = None
        if image.ndim == 2:
            camera = self._images.find_camera(cast("Floats", image), self._camera)
        else:
            image = self._images.convert_image(cast("Image", image))
        return LiveFrame(image=image, time_s=now_s, stamp_s=stamp_s, camera=camera)

    def close(self) -> None:
        """Disconnect."""
        self._open.close()
        self._link = None

    def _receive(self, timeout_s: float) -> bytes | None:
        """The content of the next image message.

        None after `timeout_s`, or for another message, which is handled.
        """
        from websockets.exceptions import ConnectionClosed

        try:
            received = self._link.recv(timeout=timeout_s)
        except TimeoutError:
            return None
        except ConnectionClosed:
            raise LiveSourceLost(
                f"'{self.title}' has closed the connection; trying again"
            ) from None
        if isinstance(received, str):
            self._handle_text(received)
            return None
        if len(received) < _MESSAGE.size or received[0] != _MESSAGE_DATA:
            return None
        _, subscription, _ = _MESSAGE.unpack_from(received)
        if subscription == _CAMERA_ID and self._camera_channel is not None:
            self._read_camera(self._camera_channel, received[_MESSAGE.size :])
        return received[_MESSAGE.size :] if subscription == _IMAGE_ID else None

    def _handle_text(self, text: str) -> None:
        """Note channels that the server advertises, and subscribe to the wanted ones."""
        try:
            told = json.loads(text)
            for one in told.get("channels", ()) if told.get("op") == "advertise" else ():
                channel = _parse_channel(one)
                self._channels[channel.id] = channel
        except (ValueError, TypeError, KeyError, AttributeError):
            raise LiveSourceLost(
                f"'{self.title}' does not speak the protocol of Foxglove; check the port"
            ) from None
        self._subscribe()

    def _subscribe(self) -> None:
        images = [c for c in self._channels.values() if c.schema in IMAGE_SCHEMAS]
        wanted = [
            c
            for c in images
            if not self._topic or c.mcap.topic.strip("/") == self._topic.strip("/")
        ]
        if self._image is None and len(wanted) == 1:
            self._image = wanted[0]
            self._topic = self._image.mcap.topic
            self._images.file_names = (self._topic,)
            self._send_subscription(_IMAGE_ID, self._image)
        if self._image is not None and self._camera_channel is None:
            folder = self._image.mcap.topic.rpartition("/")[0]
            for channel in self._channels.values():
                if (
                    channel.schema in _CAMERA_SCHEMAS
                    and channel.mcap.topic.rpartition("/")[0] == folder
                ):
                    self._camera_channel = channel
                    self._send_subscription(_CAMERA_ID, channel)
                    return

    def _send_subscription(self, subscription: int, channel: _Channel) -> None:
        wanted = {
            "op": "subscribe",
            "subscriptions": [{"id": subscription, "channelId": channel.id}],
        }
        self._link.send(json.dumps(wanted))

    def _describe_topics(self) -> str:
        images = sorted(c.mcap.topic for c in self._channels.values() if c.schema in IMAGE_SCHEMAS)
        if not images:
            others = ", ".join(sorted(c.mcap.topic for c in self._channels.values())) or "nothing"
            return escape_text(
                f"'{self._address}' publishes no images but {others:.200}; trying again"
            )
        names = ", ".join(images)
        if not self._topic:
            return escape_text(
                f"'{self._address}' has several topics of images, name one of {names} after the "
                "address"
            )
        return escape_text(
            f"'{self._address}' has no topic {self._topic!r} of images; there are {names}"
        )

    def _read_camera(self, channel: _Channel, content: bytes) -> None:
        """Keep the intrinsics that the server publishes beside the images.

        Raises CalibrationError for impossible ones; fx of 0 is ROS's word for "not calibrated".
        """
        assert self._decoders is not None
        told = self._decoders.decode(channel.mcap, content)
        k = tuple(told.K if hasattr(told, "K") else told.k)
        if len(k) == _N_INTRINSICS and k[0] != 0.0:
            rows, cols = int(told.height), int(told.width)
            self._camera = Camera(
                rows=rows, cols=cols, fx_px=k[0], fy_px=k[4], cx_px=k[2], cy_px=k[5]
            )


def _parse_channel(told: dict[str, Any]) -> _Channel:
    """A channel as the server describes it.

    Raises KeyError, TypeError or ValueError for other JSON.
    """
    from mcap.records import Schema

    encoding = str(told["encoding"])
    text = str(told.get("schema", ""))
    kind = str(
        told.get("schemaEncoding") or {"cdr": "ros2msg", "ros1": "ros1msg"}.get(encoding, encoding)
    )
    data = base64.b64decode(text) if kind == "protobuf" else text.encode()
    schema = Schema(id=int(told["id"]), name=str(told["schemaName"]), encoding=kind, data=data)
    channel = McapChannel(topic=str(told["topic"]), message_encoding=encoding, schema=schema)
    return _Channel(id=int(told["id"]), mcap=channel)


def _holds_depth(message: Any) -> bool:
    if hasattr(message, "encoding"):
        return str(message.encoding) in _DEPTH
    told = str(message.format).lower()
    return "compresseddepth" in told or "16uc1" in told


def _unpack_depth(message: Any) -> Floats:
    """Depth (rows, cols) in mm, NaN where there is none; raises ValueError for other images."""
    if hasattr(message, "encoding"):
        kind, mm = _DEPTH[str(message.encoding)]
        rows = int(message.height)
        cols = int(message.width)
        step = int(message.step)
        size = np.dtype(kind).itemsize
        lines = np.frombuffer(bytes(message.data), np.uint8, rows * step).reshape(rows, step)
        raw: Any = np.ascontiguousarray(lines[:, : cols * size]).view(kind)
    else:
        import cv2

        content = bytes(message.data)
        start = content.find(_PNG)  # ROS puts a header of 12 bytes before the picture
        if start < 0:
            raise FileProblem("compressed depth is not a PNG; publish 16UC1 or PNG", Path("depth"))
        raw = cv2.imdecode(np.frombuffer(content, np.uint8, offset=start), cv2.IMREAD_UNCHANGED)
        if raw is None or raw.ndim != 2 or raw.dtype != np.uint16:
            raise ValueError("no image of 16 bits")
        mm = 1.0
    return scale_depth(raw, mm)
