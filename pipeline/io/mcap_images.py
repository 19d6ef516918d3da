"""Image topics of an MCAP file as streams: Foxglove's schemas (protobuf, JSON) and those of ROS 2.

Images of a topic are in the order of their header stamps, then of their sequence numbers, then of
the file. The time at which a message was written is used where there are no stamps: a bag's clock
may stand still.
"""

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from pipeline.core.arrays import Image
from pipeline.core.errors import FileProblem, SettingProblem, TouchError
from pipeline.core.files import require_file
from pipeline.core.values.frames import Recording
from pipeline.io.formats import ReadOptions, RecordingFiles
from pipeline.io.gel_streams import ImageSource, make_film, make_streams
from pipeline.io.image_files import NO_DEPTH, decode_rgb, unpack_rgb
from pipeline.io.mcap_records import McapChannel, McapFile, McapMessage

_PREVIEW_PROFILE = "tactoscope previews"  # of previews that version 0.2 wrote
IMAGE_SCHEMAS = frozenset(
    {
        "foxglove.CompressedImage",
        "foxglove.RawImage",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
    }
)
_VIDEO = "CompressedVideo"  # end of the names of video schemas
_NS_PER_S = 10**9
# frames by which an image may be written too late; more is a clock that was set back
_MAX_STEPS_BACK = 10
# by which header and log times of two topics may differ; more is two clocks
_MAX_CLOCK_GAP_NS = 10 * _NS_PER_S


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """Every topic of colour images that records touch as one stream, by its name.

    See `gel_streams.make_streams`.

    Raises FileProblem, and SettingProblem where the package `mcap` is missing.
    """
    path = files.path
    require_file(path, "the MCAP file", most_bytes=1 << 50)
    decoders = make_decoders()
    file = McapFile(path)
    try:
        topics, others = _list_images(file, decoders)
        if file.profile == _PREVIEW_PROFILE:
            raise FileProblem(
                "the file holds coloured previews that were exported for viewers, not images of a "
                "sensor; open the "
                "recording that they were made from",
                path,
            )
        if not topics:
            raise FileProblem(_describe_lack(others, file.notes), path)
        times_ns, notes = _choose_times(topics)
        start_ns = min((t for of_topic in times_ns.values() for t in of_topic), default=0)
        cameras = {
            topic.strip("/"): partial(
                _make_topic,
                file,
                images,
                [(t - start_ns) / _NS_PER_S for t in times_ns[topic]],
                decoders,
                path,
            )
            for topic, images in sorted(topics.items())
        }
        streams, about = make_streams(cameras, path, options)
    except TouchError:
        file.close()
        raise
    except Exception as error:
        file.close()
        raise FileProblem(f"the MCAP file is damaged ({error!r:.80})", path) from error
    return Recording(
        path=path,
        format="MCAP file",
        streams=streams,
        close=file.close,
        notes=(*file.notes, *notes, *about),
    )


class Decoders:
    """Decoders of messages, by the packages that are installed."""

    def __init__(self, factories: Sequence[Any]) -> None:
        self._factories = factories
        self._of_channel = dict[int, Any]()

    def decode(self, channel: McapChannel, content: bytes) -> Any:
        """The message with its fields as attributes.

        Raises ValueError where no package decodes it.
        """
        encoding = channel.message_encoding
        if encoding == "json":
            return _decode_json(content)
        if id(channel) not in self._of_channel:
            found = (f.decoder_for(encoding, channel.schema) for f in self._factories)
            self._of_channel[id(channel)] = next(filter(None, found), None)
        decoder = self._of_channel[id(channel)]
        if decoder is None:
            raise ValueError(f"no decoder for {encoding!r}")
        return decoder(content)


def make_decoders() -> Decoders:
    """Decoders of JSON, protobuf and ROS 2 messages.

    Raises SettingProblem without the package `mcap`.
    """
    try:
        # the packages below need it, and it brings what unfolds chunks
        import mcap.reader as _  # noqa: F401
    except ImportError as error:
        raise SettingProblem(
            "messages are read by mcap, which is not installed; pip install mcap-protobuf-support"
        ) from error
    factories: list[Any] = []
    with suppress(ImportError):
        from mcap_protobuf.decoder import DecoderFactory

        factories.append(DecoderFactory())
    with suppress(ImportError):
        from mcap_ros2.decoder import DecoderFactory as RosDecoderFactory

        factories.append(RosDecoderFactory())
    return Decoders(factories)


def _decode_json(content: bytes) -> Any:
    """A JSON message, whose bytes are base64."""
    fields = json.loads(content)
    return SimpleNamespace(**{**fields, "data": base64.b64decode(fields["data"])})


def _list_images(
    file: McapFile, decoders: Decoders
) -> tuple[dict[str, list[McapMessage]], dict[str, str]]:
    """(topic -> its images in the order of the file, topic -> schema of everything else)."""
    topics = dict[str, list[McapMessage]]()
    others = dict[str, str]()
    for message, content in file.iterate():
        schema = "" if message.channel.schema is None else message.channel.schema.name
        if schema in IMAGE_SCHEMAS:
            stamp_ns = read_stamp_ns(message.channel, content, decoders)
            stamped = replace(message, stamp_ns=stamp_ns)
            topics.setdefault(message.channel.topic, []).append(stamped)
        else:
            others[message.channel.topic] = schema
    return topics, others


def read_stamp_ns(channel: McapChannel, content: bytes, decoders: Decoders) -> int:
    """The time in the header of an image; 0 where it has none or cannot be decoded."""
    try:
        # the header comes first; to decode all would take a copy of the pixels
        if channel.message_encoding == "cdr":
            seconds, rest = struct.unpack_from("<iI" if content[1] & 1 else ">iI", content, 4)
            return seconds * _NS_PER_S + rest
        if channel.message_encoding == "json":
            fields = json.loads(content)
            stamp = fields.get("timestamp") or fields.get("header", {}).get("stamp") or {}
            return int(stamp.get("sec", 0)) * _NS_PER_S + int(
                stamp.get("nsec", stamp.get("nanosec", 0))
            )
        return int(decoders.decode(channel, content).timestamp.ToNanoseconds())
    except (ValueError, TypeError, AttributeError, LookupError, struct.error):
        return 0


def _tells_times(times_ns: Sequence[int]) -> bool:
    """Whether times tell one moment from another."""
    return min(times_ns) >= 0 and (len(times_ns) == 1 or len(set(times_ns)) > 1)


def _has_stamps(images: Sequence[McapMessage]) -> bool:
    """Whether all headers tell their time; a clock may begin at 0, which else means "not set"."""
    stamps_ns = [image.stamp_ns for image in images]
    return _tells_times(stamps_ns) and stamps_ns.count(0) < 2 and not _is_set_back(images)


def _is_set_back(images: Sequence[McapMessage]) -> bool:
    """Whether the clock of the headers was set back while that of the log went on."""
    if len(images) < 2 or not _tells_times([image.log_time_ns for image in images]):
        return False
    written = sorted(images, key=lambda image: (image.log_time_ns, image.sequence))
    steps_ns = np.diff([image.stamp_ns for image in written])
    return bool(steps_ns.min() < -_MAX_STEPS_BACK * np.median(np.abs(steps_ns)))


def _choose_times(
    topics: Mapping[str, Sequence[McapMessage]],
) -> tuple[dict[str, list[int]], tuple[str, ...]]:
    """(topic -> times of its images in ns, notes): one clock for all topics.

    [] where none tells the time.
    """
    stamps = {topic: [i.stamp_ns for i in images] for topic, images in topics.items()}
    logs = {topic: [i.log_time_ns for i in images] for topic, images in topics.items()}
    has_stamps = all(map(_has_stamps, topics.values()))
    has_logs = all(map(_tells_times, logs.values()))
    gaps_ns = [float(np.median(np.subtract(stamps[topic], logs[topic]))) for topic in topics]
    is_one_clock = not has_logs or max(gaps_ns) - min(gaps_ns) <= _MAX_CLOCK_GAP_NS
    notes: tuple[str, ...] = ()
    if has_stamps and not is_one_clock:
        notes = (
            "the headers of the topics are of different clocks, so the times at which they were "
            "written are used",
        )
    if has_logs and any(map(_is_set_back, topics.values())):
        notes = (
            "the clock of the headers was set back, so the times at which images were written are "
            "used",
        )
    if has_stamps and is_one_clock:
        return stamps, notes
    if has_logs:
        return logs, notes
    return {
        topic: stamps[topic]
        if _has_stamps(images)
        else logs[topic]
        if _tells_times(logs[topic])
        else []
        for topic, images in topics.items()
    }, notes


def _describe_lack(others: Mapping[str, str], notes: Sequence[str]) -> str:
    """Why a file holds no images, as a clause."""
    video = [topic for topic, schema in others.items() if schema.endswith(_VIDEO)]
    if video:
        return (
            f"the topic {video[0]} holds video, which is not read; export it as a video file "
            "or as images"
        )
    if others:
        return f"the MCAP file has no topic of images, but {', '.join(sorted(others))}"
    return f"the MCAP file has no topic of images{f'; {notes[0]}' if notes else ''}"


def decode_image(message: Any, where: str, path: Path) -> Image:
    """(rows, cols, 3) RGB of a decoded image message, compressed or plain; raises FileProblem."""
    if hasattr(message, "format"):
        if "compresseddepth" in str(message.format).lower():
            raise FileProblem(f"{where} holds depth: {NO_DEPTH}", path)
        return decode_rgb(bytes(message.data), where, path)
    shape = int(message.height), int(message.width)
    return unpack_rgb(
        bytes(message.data), shape, int(message.step), str(message.encoding), where, path
    )


def _make_topic(
    file: McapFile,
    images: Sequence[McapMessage],
    times_s: Sequence[float],
    decoders: Decoders,
    path: Path,
) -> ImageSource:
    """The images of one topic by stamp where all have one, then sequence number, then place in
    the file; times since the first image of the file, [] where no clock tells them.
    """
    by_stamp = _has_stamps(images)
    order = sorted(
        range(len(images)),
        key=lambda k: (
            images[k].stamp_ns if by_stamp else images[k].log_time_ns,
            images[k].sequence,
        ),
    )

    def read(index: int) -> Image:
        message = images[order[index]]
        where = f"frame {index}"
        try:
            image = decoders.decode(message.channel, file.read_content(message))
            return decode_image(image, where, path)
        except TouchError:
            raise
        except Exception as error:
            topic = message.channel.topic
            raise FileProblem(f"{where} of {topic} cannot be read", path) from error

    times = np.array([times_s[k] if times_s else np.nan for k in order])
    return make_film(path, len(images), read, times)
