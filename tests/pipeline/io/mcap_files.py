"""MCAP files of ROS 2 images, with the clocks that a test asks for."""

from __future__ import annotations

import struct

import numpy as np
from mcap.writer import CompressionType, Writer

_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_LINE = "=" * 80 + "\n"
RAW = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 "
    f"is_bigendian\nuint32 step\nuint8[] data\n{_LINE}{_HEADER}{_LINE}{_TIME}"
)
COMPRESSED = f"std_msgs/Header header\nstring format\nuint8[] data\n{_LINE}{_HEADER}{_LINE}{_TIME}"


def pack(stamp_ns, *fields):
    """CDR of a header without a frame, then texts, numbers and bytes."""
    out = bytearray(struct.pack("<iI", stamp_ns // 10**9, stamp_ns % 10**9))
    for field in ("", *fields):
        if field is not True and field is not False:
            out += bytes(-len(out) % 4)
        if isinstance(field, bool):
            out += bytes([field])
        elif isinstance(field, int):
            out += struct.pack("<I", field)
        else:
            content = field if isinstance(field, bytes) else field.encode() + b"\0"
            out += struct.pack("<I", len(content)) + content
    return b"\0\1\0\0" + bytes(out)


def raw(image, stamp_ns=0, encoding="rgb8"):
    rows, cols = image.shape[:2]
    content = np.ascontiguousarray(image).tobytes()
    return "sensor_msgs/msg/Image", pack(
        stamp_ns, rows, cols, encoding, False, len(content) // rows, content
    )


def compressed(content, stamp_ns=0, kind="png"):
    return "sensor_msgs/msg/CompressedImage", pack(stamp_ns, kind, content)


def write_ros(
    path,
    topics,
    *,
    compression=CompressionType.ZSTD,
    ends=True,
    index=True,
    sequences=None,
    chunked=True,
):
    """`topics`: name -> [(log time in ns, message of `raw` or `compressed`)].

    Written in the order of the log times.
    """
    with path.open("wb") as file:
        writer = Writer(
            file,
            compression=compression,
            chunk_size=200_000,
            use_chunking=chunked,
            enable_data_crcs=True,
            use_statistics=index,
            use_summary_offsets=index,
            repeat_schemas=index,
            repeat_channels=index,
        )
        writer.start("ros2", "test")
        rows = []
        for topic, messages in topics.items():
            name = messages[0][1][0]
            text = RAW if name.endswith("/Image") else COMPRESSED
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            rows += [
                (log_ns, k, channel, content) for k, (log_ns, (_, content)) in enumerate(messages)
            ]
        for log_ns, k, channel, content in sorted(rows, key=lambda row: row[0]):
            writer.add_message(channel, log_ns, content, log_ns, sequences[k] if sequences else k)
        writer.finish()
    if not ends:
        content = path.read_bytes()
        # before the data's end
        path.write_bytes(content[: content.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")])
    return path
