"""Reading a session log, which may be complete, truncated anywhere, or damaged inside."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from glissando.errors import RecordingError, needing
from glissando.geometry.se3 import Array
from glissando.io.plain_file import largest_unpacked, require_plain

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # header of a record: its kind and the length of its body
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA = 2, 3, 4, 5, 6, 12


@dataclass(frozen=True)
class Topic:
    """Messages of one stream in the order in which they were written.

    Attributes:
        name: Name of the topic.
        schema: JSON schema of the messages.
        metadata: Metadata of the topic.
        time_ns: Log times (M,), ns of the monotonic clock.
        messages: The M messages.
    """

    name: str
    schema: dict[str, Any]
    metadata: dict[str, str]
    time_ns: NDArray[np.int64]
    messages: list[dict[str, Any]]

    def column(self, key: str) -> Array:
        """One property of all messages as numbers (M, …); NaN where it is null or absent.

        Raises:
            RecordingError: The property is not numeric, or its lists differ in length.
        """
        rows = [message.get(key) for message in self.messages]
        like = next((row for row in rows if row is not None), None)
        try:
            none = np.full(np.shape(like), np.nan) if isinstance(like, list) else np.nan
            return np.array([none if row is None else row for row in rows], dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise RecordingError(
                f"Topic {self.name!r}: {key!r} is not a number, or as many, a message."
            ) from None


@dataclass(frozen=True)
class RawSession:
    """Content of a session log.

    Attributes:
        topics: Topics by name.
        metadata: Metadata of the session.
        complete: Whether the log was closed properly.
        damaged: Number of records and messages that could not be read.
    """

    topics: dict[str, Topic]
    metadata: dict[str, str]
    complete: bool
    damaged: int


def read_session(path: str | Path) -> RawSession:
    """Read a session log, which may be complete, truncated anywhere, or damaged inside.

    Raises:
        RecordingError: The file cannot be opened or is not an MCAP file.
        GlissandoError: mcap is not installed.
    """
    with needing("Reading MCAP files needs mcap", "hardware"):
        import mcap.records  # noqa: F401
    try:
        require_plain(Path(path), 1 << 40)
        contents = _Contents(largest_unpacked(Path(path).stat().st_size))
        with Path(path).open("rb") as file:
            for kind, body in _records(file, path):
                try:
                    contents.take(kind, body)
                except Exception:  # whatever damaged bytes make a decoder raise
                    contents.damaged += 1
    except OSError as problem:
        raise RecordingError(f"{path} cannot be read ({problem.strerror}).") from None
    topics = {c.topic: contents.topic(c) for c in contents.channels.values()}
    return RawSession(topics, contents.metadata, contents.complete, contents.damaged)


def _records(file: BinaryIO, path: str | Path) -> Iterator[tuple[int, bytes]]:
    """Kinds and bodies of the complete records of a file."""
    magic = file.read(len(_MAGIC))
    if not _MAGIC.startswith(magic):
        raise RecordingError(f"{path} is not an MCAP file; give one that SessionWriter wrote.")
    yield from _records_from(file)


def _records_from(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Kinds and bodies of the complete records from the file's present position."""
    begin = file.tell()
    size = file.seek(0, os.SEEK_END)
    file.seek(begin)
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        kind, length = _HEAD.unpack(head)
        if kind == 0 or file.tell() + length > size:
            return
        yield kind, file.read(length)
        if kind == _FOOTER:
            return


@dataclass
class _Contents:
    """Content of the records read so far; messages by channel, not yet decoded.

    `left` is the number of bytes to which further chunks may unpack.
    """

    left: int
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    messages: dict[int, list[Any]] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    complete: bool = False
    damaged: int = 0

    def take(self, kind: int, body: bytes) -> None:
        """Read one record; kinds that only repeat others, such as indices, are skipped."""
        from mcap import records
        from mcap.data_stream import ReadDataStream

        stream = ReadDataStream(BytesIO(body))
        if kind == _CHUNK:
            for inner, part in _records_from(BytesIO(self.unpacked(records.Chunk.read(stream)))):
                if inner in (_SCHEMA, _CHANNEL, _MESSAGE):
                    self.take(inner, part)
        elif kind == _MESSAGE:
            self.keep(records.Message.read(stream, len(body)))
        elif kind in (_SCHEMA, _CHANNEL):
            self.keep((records.Schema if kind == _SCHEMA else records.Channel).read(stream))
        elif kind == _METADATA:
            record = records.Metadata.read(stream)
            self.metadata |= record.metadata if record.name == "session" else {}
        self.complete |= kind == _FOOTER

    def unpacked(self, chunk: Any) -> bytes:
        """Unpacked records of a chunk. Raises ValueError if it is damaged or too large."""
        data: bytes = chunk.data
        if chunk.compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            data = LZ4FrameDecompressor().decompress(chunk.data, self.left + 1)
        elif chunk.compression == "zstd":
            from zstandard import ZstdDecompressor

            data = ZstdDecompressor().stream_reader(BytesIO(chunk.data)).read(self.left + 1)
        self.left -= len(data)
        if self.left < 0:
            raise ValueError("the log unpacks to more than a log of its size may")
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise ValueError("the chunk is damaged")
        return data

    def keep(self, record: Any) -> None:
        """Store a schema, a channel or a message."""
        from mcap.records import Channel, Schema

        if isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        else:
            self.messages.setdefault(record.channel_id, []).append(record)

    def topic(self, channel: Any) -> Topic:
        """Topic of a channel, with all of its readable messages."""
        rows = self.messages.get(channel.id, [])
        rows = [(row.log_time, self._decoded(row.data)) for row in rows]
        rows = [row for row in rows if row[1] is not None and row[0] < 1 << 63]
        made = self.schemas.get(channel.schema_id)
        described = (self._decoded(made.data) if made else None) or {}
        times = np.array([t for t, _ in rows], dtype=np.int64)
        return Topic(channel.topic, described, channel.metadata, times, [m for _, m in rows])

    def _decoded(self, data: bytes) -> dict[str, Any] | None:
        try:
            message = json.loads(data)
        except (ValueError, RecursionError):
            message = None
        if not isinstance(message, dict):
            self.damaged += 1
            return None
        return message
