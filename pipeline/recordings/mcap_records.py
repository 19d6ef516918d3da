"""The messages of an MCAP file: one pass over its records finds each, with or without the file's own index.

A file that was cut short or never closed has no footer and no index; what is there up to its end is read. Records of
chunks are checked against their checksums. Layout: https://mcap.dev/spec.
"""

import struct
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from pipeline.base.errors import FileProblem, StageWarning

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 1, 2, 3, 4, 5, 6, 15
_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK_HEAD = struct.Struct("<QQQI")  # first and last time, unfolded size, its checksum
_FOOTER_TAIL = struct.Struct("<BQQQI")  # opcode and length, then where the summary is, and its checksum
_MAX_RECORD_BYTES = 1 << 30  # as stated, of a chunk unfolded and of any record that is read
_MAX_UNFOLDED = 200  # times the size of the file, for all chunks together
_MIN_BUDGET_BYTES = 1 << 28
_BLOCK_BYTES = 1 << 20
_IN_FILE = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class McapSchema:
    """The type of a channel's messages, with the names that decoders of the package `mcap` expect."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class McapChannel:
    """A topic with the type and encoding of its messages."""

    topic: str
    message_encoding: str
    schema: McapSchema | None


@dataclass(frozen=True, slots=True, kw_only=True)
class McapMessage:
    """Where a message is, and when it was recorded."""

    channel: McapChannel
    sequence: int
    log_time_ns: int
    chunk: int  # offset of its chunk in the file; -1 = it lies in the file itself
    offset: int  # of its content in the chunk or file
    n_bytes: int


class McapFile:
    """An open MCAP file; every access unfolds at most one chunk, and keeps the last one."""

    def __init__(self, path: Path) -> None:
        """Raises FileProblem for a file that begins otherwise."""
        self._path, self._lock = path, threading.Lock()
        self._file: IO[bytes] = path.open("rb")
        self._n_bytes = path.stat().st_size
        self._unfolded: tuple[int, bytes] = _IN_FILE, b""
        self._budget = max(_MIN_BUDGET_BYTES, _MAX_UNFOLDED * self._n_bytes)
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
        with self._lock:
            if message.chunk == _IN_FILE:
                self._file.seek(message.offset)
                return self._file.read(message.n_bytes)
            if self._unfolded[0] != message.chunk:
                self._file.seek(message.chunk)
                self._unfolded = message.chunk, self._unfold(self._file.read(self._read_head()[1]), message.chunk)
            return self._unfolded[1][message.offset : message.offset + message.n_bytes]

    def iterate(self) -> Iterator[tuple[McapMessage, bytes]]:
        """Every message in the order of the file, with its content; adds notes about what is lost.

        Raises FileProblem for sizes beyond all bounds, and for a checksum that does not fit the file as a whole.
        """
        self._schemas, self._channels = dict[int, McapSchema](), dict[int, McapChannel]()
        self._read_summary()
        checksum, is_chunk_damaged = zlib.crc32(MAGIC), False
        at = len(MAGIC)
        while True:
            self._file.seek(at)
            head = self._file.read(_HEAD.size)
            opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
            if not opcode or at + _HEAD.size + length > self._n_bytes:
                self.notes.append(
                    StageWarning(
                        "the MCAP file has no end: it was cut short or not closed; what is there up to then is read"
                    )
                )
                return
            if opcode == _FOOTER:
                return
            if opcode in (_CHUNK, _MESSAGE, _SCHEMA, _CHANNEL, _HEADER, _DATA_END):
                content = self._file.read(self._check_size(length, at))
                if opcode == _DATA_END:
                    (stated,) = struct.unpack_from("<I", content)
                    if stated not in (0, checksum) and not is_chunk_damaged:
                        raise FileProblem(
                            "the MCAP file is damaged: its checksum does not fit; copy it again, or mend it with "
                            "`mcap recover`", self._path,
                        )  # fmt: skip
                checksum = zlib.crc32(content, zlib.crc32(head, checksum))
            else:
                content, checksum = b"", self._skip(length, zlib.crc32(head, checksum))
            if opcode == _HEADER:
                self.profile = _read_text(content, 0)[0]
            elif opcode == _CHUNK:
                try:
                    unfolded = self._unfold(content, at)
                except FileProblem as problem:
                    is_chunk_damaged = True
                    self.notes.append(StageWarning(f"{str(problem).rsplit(': ', 1)[0]}; its images are left out"))
                else:
                    self._unfolded = at, unfolded
                    yield from self._list_records(unfolded, at)
            else:
                yield from self._parse_record(opcode, content, _IN_FILE, at + _HEAD.size)
            at += _HEAD.size + length

    def _read_summary(self) -> None:
        """Read the types and topics that a closed file repeats at its end: the chunk that holds them may be damaged."""
        self._file.seek(-min(_FOOTER_TAIL.size + len(MAGIC), self._n_bytes), 2)
        tail = self._file.read(_FOOTER_TAIL.size)
        if len(tail) < _FOOTER_TAIL.size or _FOOTER_TAIL.unpack(tail)[:2] != (_FOOTER, 20):
            return
        at = _FOOTER_TAIL.unpack(tail)[2]
        while 0 < at < self._n_bytes:
            self._file.seek(at)
            opcode, length = self._read_head()
            if opcode not in (_SCHEMA, _CHANNEL) or length > self._n_bytes:
                return
            for _ in self._parse_record(opcode, self._file.read(length), _IN_FILE, at):
                pass
            at += _HEAD.size + length

    def _read_head(self) -> tuple[int, int]:
        return _HEAD.unpack(self._file.read(_HEAD.size))

    def _skip(self, length: int, checksum: int) -> int:
        """The checksum after a record that is not needed."""
        while length > 0:
            block = self._file.read(min(length, _BLOCK_BYTES))
            checksum, length = zlib.crc32(block, checksum), length - max(len(block), 1)
        return checksum

    def _list_records(self, unfolded: bytes, chunk: int) -> Iterator[tuple[McapMessage, bytes]]:
        at = 0
        while at + _HEAD.size <= len(unfolded):
            opcode, length = _HEAD.unpack_from(unfolded, at)
            at += _HEAD.size
            if at + length > len(unfolded):
                self.notes.append(StageWarning(f"the chunk at byte {chunk} ends within a record; the rest is left out"))
                return
            yield from self._parse_record(opcode, unfolded[at : at + length], chunk, at)
            at += length

    def _parse_record(self, opcode: int, content: bytes, chunk: int, at: int) -> Iterator[tuple[McapMessage, bytes]]:
        if opcode == _SCHEMA:
            (number,) = struct.unpack_from("<H", content)
            name, after = _read_text(content, 2)
            encoding, after = _read_text(content, after)
            self._schemas[number] = McapSchema(id=number, name=name, encoding=encoding, data=content[after + 4 :])
        elif opcode == _CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, after = _read_text(content, 4)
            encoding, _ = _read_text(content, after)
            self._channels[number] = McapChannel(
                topic=topic, message_encoding=encoding, schema=self._schemas.get(schema)
            )
        elif opcode == _MESSAGE:
            number, sequence, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
            if number in self._channels:
                yield (
                    McapMessage(
                        channel=self._channels[number], sequence=sequence, log_time_ns=log_time_ns, chunk=chunk,
                        offset=at + _MESSAGE_HEAD.size, n_bytes=len(content) - _MESSAGE_HEAD.size,
                    ),
                    content[_MESSAGE_HEAD.size :],
                )  # fmt: skip

    def _check_size(self, n_bytes: int, at: int) -> int:
        if n_bytes > _MAX_RECORD_BYTES:
            raise FileProblem(f"the record at byte {at} states {n_bytes / 1e9:.1f} GB", self._path)
        return n_bytes

    def _unfold(self, content: bytes, at: int) -> bytes:
        """The records of a chunk; raises FileProblem where its size or checksum does not fit."""
        _, _, size, checksum = _CHUNK_HEAD.unpack_from(content)
        compression, after = _read_text(content, _CHUNK_HEAD.size)
        (n_stored,) = struct.unpack_from("<Q", content, after)
        stored = content[after + 8 : after + 8 + n_stored]
        if size > min(_MAX_RECORD_BYTES, self._budget):
            raise FileProblem(f"the chunk at byte {at} states {size / 1e9:.1f} GB", self._path)
        try:
            unfolded = _decompress(stored, compression, size)
        except Exception as error:
            raise FileProblem(f"the chunk at byte {at} is damaged and cannot be unfolded", self._path) from error
        if len(unfolded) != size or (checksum and zlib.crc32(unfolded) != checksum):
            raise FileProblem(f"the chunk at byte {at} is damaged: its checksum does not fit", self._path)
        return unfolded


def _read_text(content: bytes, at: int) -> tuple[str, int]:
    """(text, offset after it) of a text with its length before it."""
    (length,) = struct.unpack_from("<I", content, at)
    return content[at + 4 : at + 4 + length].decode("utf-8"), at + 4 + length


def _decompress(stored: bytes, compression: str, size: int) -> bytes:
    """At most one byte more than the stated size, so that a false one is noticed before it fills the memory."""
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
