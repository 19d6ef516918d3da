"""Image topics of an MCAP file as streams: Foxglove's schemas (protobuf, JSON) and those of ROS 2."""

import base64
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from pipeline.base.arrays import Image
from pipeline.base.errors import FileProblem, SettingProblem, TouchError
from pipeline.base.files import require_file
from pipeline.recordings.encoded_images import decode_rgb, unpack_rgb
from pipeline.recordings.formats import ReadOptions, RecordingFiles
from pipeline.recordings.image_sequence import make_stream
from pipeline.values.frames import Recording

_SCHEMAS = frozenset({
    "foxglove.CompressedImage", "foxglove.RawImage", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image",
})  # fmt: skip
_MAX_CHUNK_BYTES = 1 << 30  # uncompressed, as stated


def read(files: RecordingFiles, options: ReadOptions) -> Recording:
    """Every topic of colour images that can be read as one stream, by its name.

    Raises FileProblem, and SettingProblem where the package `mcap` is missing.
    """
    path = files.path
    require_file(path, "the MCAP file", most_bytes=1 << 50)
    try:
        from mcap.reader import make_reader
    except ImportError as error:
        raise SettingProblem(
            "MCAP files are read by mcap, which is not installed; pip install mcap-protobuf-support"
        ) from error
    file = path.open("rb")
    try:
        reader: Any = make_reader(file, decoder_factories=_make_decoders())
        times_ns = _list_times(reader, path)
        found, problems = list[Any](), dict[str, FileProblem]()
        for topic, times in times_ns.items():
            try:
                found.append(make_stream(_Topic(reader, topic, times, path), path, options, name=topic.strip("/")))
            except FileProblem as problem:
                problems[topic] = problem
    except TouchError:
        file.close()
        raise
    except Exception as error:
        file.close()
        raise FileProblem(f"the MCAP file is damaged ({error!r:.80})", path) from error
    if not found:
        file.close()
        raise next(iter(problems.values()), FileProblem("the MCAP file has no topic of images", path))
    notes = dict.fromkeys(note for _, about in found for note in about)
    left_out = [f"the topic {topic} is left out: {problem}" for topic, problem in problems.items()]
    return Recording(path=path, format="MCAP file", streams=tuple(stream for stream, _ in found), close=file.close,
                     notes=(*files.notes, *notes, *left_out))  # fmt: skip


def _make_decoders() -> list[Any]:
    """Decoders of the packages that are installed."""
    decoders: list[Any] = [_JsonDecoders()]
    try:
        from mcap_protobuf.decoder import DecoderFactory

        decoders.append(DecoderFactory())
    except ImportError:
        pass
    try:
        from mcap_ros2.decoder import DecoderFactory as RosDecoderFactory

        decoders.append(RosDecoderFactory())
    except ImportError:
        pass
    return decoders


class _JsonDecoders:
    """Decoders of JSON messages, whose bytes are base64."""

    def decoder_for(self, message_encoding: str, _schema: Any) -> Any:
        """The decoder; None for other encodings."""
        return _decode_json if message_encoding == "json" else None


def _decode_json(content: bytes) -> Any:
    fields = json.loads(content)
    return SimpleNamespace(**{**fields, "data": base64.b64decode(fields["data"])})


def _list_times(reader: Any, path: Path) -> dict[str, list[int]]:
    """Topic -> times of its images in ns; a message of each is found again by its time."""
    summary = reader.get_summary()
    for chunk in summary.chunk_indexes if summary else ():
        if chunk.uncompressed_size > _MAX_CHUNK_BYTES:
            raise FileProblem(f"a chunk states {chunk.uncompressed_size / 1e9:.1f} GB", path)
    times: dict[str, list[int]] = {}
    for schema, channel, message in reader.iter_messages():
        if schema is not None and schema.name in _SCHEMAS:
            times.setdefault(channel.topic, []).append(message.log_time)
    return {topic: sorted(set(of_topic)) for topic, of_topic in sorted(times.items())}


class _Topic:
    """The images of one topic."""

    def __init__(self, reader: Any, topic: str, times_ns: list[int], path: Path) -> None:
        self._reader, self._topic, self._times_ns, self._path = reader, topic, times_ns, path

    @property
    def n_frames(self) -> int:
        """Number of images."""
        return len(self._times_ns)

    def frame(self, index: int) -> Image:
        """(rows, cols, 3) RGB."""
        at_ns, where = self._times_ns[index], f"frame {index}"
        try:
            read = self._reader.iter_decoded_messages([self._topic], starting_at=at_ns)
            message = next(iter(read)).decoded_message
            if hasattr(message, "format"):
                return decode_rgb(bytes(message.data), where, self._path)
            shape = int(message.height), int(message.width)
            return unpack_rgb(bytes(message.data), shape, int(message.step), str(message.encoding), where, self._path)
        except TouchError:
            raise
        except Exception as error:
            raise FileProblem(f"{where} of {self._topic} cannot be read", self._path, field=where) from error

    def time_s(self, index: int) -> float:
        """Time since the first image."""
        return 1e-9 * (self._times_ns[index] - self._times_ns[0])
