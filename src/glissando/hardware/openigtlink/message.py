"""Encoding of an OpenIGTLink message, and separation of a stream of bytes into messages.

A message has a header, an extended header, metadata and content. Every size is compared with the
available bytes before it is used, the checksum is verified before the body is parsed, and a stream
takes bounded memory whatever a peer sends. Source: OpenIGTLink protocol, header versions 1 to 3
(openigtlink.org); version 3 has the layout of version 2 and is read as such.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from glissando.errors import DeviceError
from glissando.hardware.openigtlink.contents import CONTENTS, Content
from glissando.hardware.openigtlink.crc import crc64
from glissando.hardware.openigtlink.fields import MessageError, fixed_text, text_of

HEADER = 58
_HEADER = struct.Struct(">H12s20sQQQ")
_EXTENDED = struct.Struct(">HHII")
_COUNT, _ENTRY = struct.Struct(">H"), struct.Struct(">HHI")
_VERSIONS = (1, 2, 3)
_ASCII, UTF8 = 3, 106  # character sets, IANA MIBenum
TICKS = 1 << 32  # units of a stamp per second


@dataclass(frozen=True)
class Header:
    """The first 58 bytes of a message.

    Attributes:
        version: Header version: 1, or 2 and 3 with extended header and metadata.
        type_id: Type of the message.
        device: Name of the device.
        stamp: Time in units of 2⁻³² s since the epoch of the sender's clock; 0 for none.
        size: Size of the body, bytes.
        crc: Checksum of the body.
    """

    version: int
    type_id: str
    device: str
    stamp: int
    size: int
    crc: int


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes:
        content: Content of the message.
        device: Name of the device, 20 bytes at most.
        stamp: Time in units of 2⁻³² s since the epoch of the sender's clock; 0 for none.
        version: Header version, 1 or 2; only 2 has an identity and metadata.
        identity: Message number assigned by the sender.
        metadata: Texts by key.
    """

    content: Content
    device: str = ""
    stamp: int = 0
    version: int = 1
    identity: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)


def stamp_of(seconds: float) -> int:
    """Convert seconds to a stamp, the nearest multiple of 2⁻³² s.

    >>> stamp_of(1.5) == 3 << 31
    True
    """
    whole = int(seconds // 1.0)
    return whole * TICKS + round((seconds - whole) * TICKS)


def seconds_since(stamp: int, origin: int) -> float:
    """Seconds from one stamp to another, exact below 2²⁰ s of difference.

    A present-day stamp in seconds as a single float would be rounded to 0.2 µs.
    """
    return (stamp - origin) / TICKS


def encode(message: Message) -> bytes:
    """Encode a message.

    Raises:
        DeviceError: A text is too long for its field, or a version 1 message has metadata.
    """
    body = message.content.pack()
    if message.version >= 2:
        body = _extended(message, body)
    elif message.metadata or message.identity:
        raise DeviceError("A version 1 header carries no metadata and no identity; give version=2.")
    kind, device = fixed_text(message.content.type_id, 12), fixed_text(message.device, 20)
    head = _HEADER.pack(message.version, kind, device, message.stamp, len(body), crc64(body))
    return head + body


def _extended(message: Message, content: bytes) -> bytes:
    index, data = [_COUNT.pack(len(message.metadata))], []
    for key, value in message.metadata.items():
        name, text = key.encode(), value.encode()
        index.append(_ENTRY.pack(len(name), _ASCII if value.isascii() else UTF8, len(text)))
        data += [name, text]
    first, second = b"".join(index), b"".join(data)
    head = _EXTENDED.pack(_EXTENDED.size, len(first), len(second), message.identity)
    return head + content + first + second


def read_header(data: bytes) -> Header:
    """Decode the header at the beginning of `data`.

    Raises:
        MessageError: There are fewer than 58 bytes, or the version is unknown.
    """
    if len(data) < HEADER:
        raise MessageError(f"A header has {HEADER} bytes, here are {len(data)}; read on.")
    version, kind, device, stamp, size, crc = _HEADER.unpack_from(data)
    if version not in _VERSIONS:
        raise MessageError(
            f"The bytes begin with version {version}; OpenIGTLink knows 1 to 3. Check that the "
            f"peer speaks OpenIGTLink."
        )
    return Header(version, text_of(kind), text_of(device), stamp, size, crc)


def decode(data: bytes) -> Message:
    """Decode a message.

    Args:
        data: Exactly one message.

    Raises:
        MessageError: Bytes are missing or damaged, the type is not in `CONTENTS`, or sizes
            contradict each other or the protocol.
    """
    header = read_header(data)
    body = data[HEADER:]
    if len(body) < header.size:
        raise MessageError(f"The body has {header.size} bytes, here are {len(body)}; read on.")
    if len(body) > header.size:
        raise MessageError(f"{len(body) - header.size} bytes follow the message; cut them off.")
    if header.type_id not in CONTENTS:
        raise MessageError(
            f"{header.type_id!r} messages are not read; known are {', '.join(CONTENTS)}."
        )
    if crc64(body) != header.crc:
        raise MessageError(f"A {header.type_id} message came damaged (CRC-64); check the link.")
    identity, metadata = 0, dict[str, str]()
    if header.version >= 2:
        identity, metadata, body = _parts(body)
    content = CONTENTS[header.type_id].unpack(body)
    return Message(content, header.device, header.stamp, header.version, identity, metadata)


def _parts(body: bytes) -> tuple[int, dict[str, str], bytes]:
    """Identity, metadata and content of a body with an extended header."""
    if len(body) < _EXTENDED.size:
        raise MessageError(f"A body of {len(body)} bytes holds no extended header.")
    size, index, data, identity = _EXTENDED.unpack_from(body)
    begin = len(body) - index - data
    if not _EXTENDED.size <= size <= begin:
        raise MessageError(
            f"An extended header of {size} bytes and metadata of {index} + {data} do not fit a "
            f"body of {len(body)}."
        )
    metadata = _metadata(body[begin : begin + index], body[begin + index :])
    return identity, metadata, body[size:begin]


def _metadata(index: bytes, data: bytes) -> dict[str, str]:
    if not index and not data:
        return {}
    count = _COUNT.unpack_from(index)[0] if len(index) >= _COUNT.size else -1
    if len(index) != _COUNT.size + count * _ENTRY.size:
        raise MessageError(f"An index of {count} metadata entries has {len(index)} bytes.")
    entries = list(_ENTRY.iter_unpack(index[_COUNT.size :]))
    stated = sum(key + value for key, _, value in entries)
    if stated != len(data) or any(key == 0 for key, _, _ in entries):
        raise MessageError(f"Metadata entries state {stated} bytes, {len(data)} are there.")
    out, at = {}, 0
    for key, _, value in entries:
        name = data[at : at + key].decode("utf-8", "replace")
        out[name] = data[at + key : at + key + value].decode("utf-8", "replace")
        at += key + value
    return out


class Framer:
    """Separates a stream into messages; bodies of unsupported types are skipped and not stored.

    Args:
        most: Largest size of the body of a message of a supported type, bytes.

    Attributes:
        skipped: Number of messages of unsupported types that were skipped.
    """

    def __init__(self, most: int = 1 << 22) -> None:
        self.skipped = 0
        self._held = bytearray()
        self._most, self._to_skip = most, 0
        self._size: int | None = None  # of the incomplete message

    def feed(self, data: bytes) -> list[bytes]:
        """Append bytes, and return the messages now complete, of which only headers are checked.

        Raises:
            MessageError: A header is invalid or its message too large, so the stream is lost.
        """
        self._held += data
        out: list[bytes] = []
        while True:
            passed = self._take(min(self._to_skip, len(self._held)))
            self._to_skip -= len(passed)
            if self._to_skip:
                return out
            if self._size is None and len(self._held) >= HEADER:
                self._begin(read_header(bytes(self._held[:HEADER])))
            elif self._size is not None and len(self._held) >= self._size:
                out.append(self._take(self._size))
                self._size = None
            else:
                return out

    def _begin(self, header: Header) -> None:
        """Determine from its header whether the next message is kept or skipped."""
        size = HEADER + header.size
        if header.type_id not in CONTENTS:
            self.skipped += 1
            self._to_skip = size
            return
        if header.size > self._most:
            raise MessageError(
                f"A {header.type_id} of {header.size} bytes is refused; {self._most} are read."
            )
        self._size = size

    def _take(self, count: int) -> bytes:
        out = bytes(self._held[:count])
        del self._held[:count]
        return out
