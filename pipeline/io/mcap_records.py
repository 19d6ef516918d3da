"""The messages of an MCAP file: one pass over its records finds each, with or without the file's
own index.

The package `mcap` reads the records. A file that was cut short or never closed has no footer and no
index; what is there up to its end is read. A chunk is unfolded here, up to the size that it states,
and one that is damaged left out.
"""

import contextlib
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from pipeline.core.errors import FileProblem, StageWarning
from pipeline.core.frozen import frozen

MAGIC = b"\x89MCAP0\r\n"
_MAX_RECORD_BYTES = 1 << 30  # as stated, of a chunk unfolded and of any record that is read
_MAX_UNFOLDED = 200  # times the size of the file, for all chunks together
_MIN_BUDGET_BYTES = 1 << 28
_CHUNK_HEAD_BYTES = 40  # before its compressed records, without the name of the compression
_IN_FILE = -1


@frozen
class McapChannel:
    """A topic with the type and encoding of its messages."""

    topic: str
    message_encoding: str
    schema: Any  # a `mcap.records.Schema`, or None


@frozen
class McapMessage:
    """Where a message is, and when it was recorded."""

    channel: McapChannel
    sequence: int
    log_time_ns: int
    chunk: int  # offset of its chunk in the file; -1 = it lies in the file itself
    place: int  # number of the record in its chunk, or offset of its content in the file
    n_bytes: int
    stamp_ns: int = 0  # in its header; 0 = none


class McapFile:
    """An open MCAP file; every access unfolds at most one chunk, and keeps the last one."""

    def __init__(self, path: Path) -> None:
        """Raises FileProblem for a file that begins otherwise."""
        self._path = path
        self._lock = threading.Lock()
        self._file: IO[bytes] = path.open("rb")
        self._unfolded: tuple[int, list[Any]] = _IN_FILE, []
        self._budget = max(_MIN_BUDGET_BYTES, _MAX_UNFOLDED * path.stat().st_size)
        self._schemas = dict[int, Any]()
        self._channels = dict[int, McapChannel]()
        self.notes = list[str]()
        self.profile = ""
        if self._file.read(len(MAGIC)) != MAGIC:
            self.close()
            raise FileProblem("the file does not begin as an MCAP file", path)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read_content(self, message: McapMessage) -> bytes:
        """The encoded content of a message; raises FileProblem."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk

        with self._lock:
            if message.chunk == _IN_FILE:
                self._file.seek(message.place)
                return self._file.read(message.n_bytes)
            if self._unfolded[0] != message.chunk:
                self._file.seek(message.chunk)
                self._unfold(Chunk.read(ReadDataStream(self._file)), message.chunk)
            return self._unfolded[1][message.place].data

    def iterate(self) -> Iterator[tuple[McapMessage, bytes]]:
        """Every message in the order of the file, with its content; adds notes about what is lost.

        Raises FileProblem for sizes beyond all bounds, and for a checksum that does not fit the
        file as a whole.
        """
        from mcap.exceptions import EndOfFile, InvalidMagic, RecordLengthLimitExceeded
        from mcap.records import Chunk, Header
        from mcap.stream_reader import CRCValidationError, StreamReader

        self._read_summary()
        self._file.seek(0)
        reader = StreamReader(
            self._file, emit_chunks=True, validate_crcs=True, record_size_limit=_MAX_RECORD_BYTES
        )
        is_chunk_damaged = False
        try:
            for record in reader.records:
                end = self._file.tell()
                if isinstance(record, Header):
                    self.profile = record.profile
                elif isinstance(record, Chunk):
                    at = (
                        end
                        - len(record.data)
                        - len(record.compression.encode())
                        - _CHUNK_HEAD_BYTES
                    )
                    try:
                        self._unfold(record, at)
                    except FileProblem as problem:
                        is_chunk_damaged = True
                        self.notes.append(
                            StageWarning(
                                f"{str(problem).rsplit(': ', 1)[0]}; its images are left out"
                            )
                        )
                        continue
                    for place, one in enumerate(self._unfolded[1]):
                        yield from self._take(one, at, place)
                    self._file.seek(end)
                else:
                    yield from self._take(record, _IN_FILE, end - len(getattr(record, "data", b"")))
                    self._file.seek(end)
        except CRCValidationError as error:
            if not is_chunk_damaged:
                raise FileProblem(
                    "the MCAP file is damaged: its checksum does not fit; copy it again, or mend "
                    "it with "
                    "`mcap recover`",
                    self._path,
                ) from error
        except (EndOfFile, InvalidMagic, RecordLengthLimitExceeded, UnicodeDecodeError):
            self.notes.append(
                StageWarning(
                    "the MCAP file has no end: it was cut short or not closed; what is there up "
                    "to then is read"
                )
            )

    def _read_summary(self) -> None:
        """Read the types and topics that a closed file repeats at its end: the chunk that holds
        them may be damaged.
        """
        from mcap.reader import SeekingReader

        self._file.seek(0)
        with contextlib.suppress(Exception):  # a file without an end is read without it
            summary = SeekingReader(self._file, record_size_limit=_MAX_RECORD_BYTES).get_summary()
            for record in (
                (*summary.schemas.values(), *summary.channels.values()) if summary else ()
            ):
                list(self._take(record, _IN_FILE, 0))

    def _take(self, record: Any, chunk: int, place: int) -> Iterator[tuple[McapMessage, bytes]]:
        """Keep a type or a topic; yield a message."""
        from mcap.records import Channel, Message, Schema

        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = McapChannel(
                topic=record.topic,
                message_encoding=record.message_encoding,
                schema=self._schemas.get(record.schema_id),
            )
        elif isinstance(record, Message) and record.channel_id in self._channels:
            yield (
                McapMessage(
                    channel=self._channels[record.channel_id],
                    sequence=record.sequence,
                    log_time_ns=record.log_time,
                    chunk=chunk,
                    place=place,
                    n_bytes=len(record.data),
                ),
                record.data,
            )

    def _unfold(self, chunk: Any, at: int) -> None:
        """Keep the records of a chunk.

        Raises FileProblem where its size or checksum does not fit.
        """
        from mcap.stream_reader import breakup_chunk

        size = chunk.uncompressed_size
        if size > min(_MAX_RECORD_BYTES, self._budget):
            raise FileProblem(f"the chunk at byte {at} states {size / 1e9:.1f} GB", self._path)
        try:
            chunk.data = _decompress(chunk.data, chunk.compression, size)
            chunk.compression = ""
            checksum = zlib.crc32(chunk.data)
            if len(chunk.data) == size and chunk.uncompressed_crc in (0, checksum):
                self._unfolded = at, breakup_chunk(chunk)
                return
        except Exception as error:
            raise FileProblem(
                f"the chunk at byte {at} is damaged and cannot be unfolded", self._path
            ) from error
        raise FileProblem(
            f"the chunk at byte {at} is damaged: its checksum does not fit", self._path
        )


def _decompress(stored: bytes, compression: str, size: int) -> bytes:
    """At most one byte more than the stated size, so that a false one is noticed before it fills
    the memory.
    """
    if compression == "zstd":
        import zstandard

        return zstandard.ZstdDecompressor().stream_reader(stored).read(size + 1)
    if compression == "lz4":
        import lz4.frame

        decompressor: Any = lz4.frame.LZ4FrameDecompressor()
        return decompressor.decompress(stored, max_length=size + 1)
    if compression:
        raise ValueError(compression)
    return stored
