"""Whole messages out of a stream of bytes, in bounded memory whatever a peer sends."""

from __future__ import annotations

from glissando.hardware.openigtlink.contents import CONTENTS
from glissando.hardware.openigtlink.fields import MessageError
from glissando.hardware.openigtlink.message import HEADER, Header, read_header


class Framer:
    """Cuts a stream into messages; bodies of types that are not read are passed over, not kept.

    Args:
        most: Bytes that the body of a message may have if it is of a type that is read.

    Attributes:
        skipped: How many messages of types that are not read were passed over.
    """

    def __init__(self, most: int = 1 << 22) -> None:
        self.skipped = 0
        self._held = bytearray()
        self._most, self._pass_over = most, 0
        self._size: int | None = None  # of the message that has begun

    def feed(self, data: bytes) -> list[bytes]:
        """The messages that are whole now, unchecked but for their headers.

        Raises:
            MessageError: No message begins here, or it is too large: the stream is lost.
        """
        self._held += data
        out: list[bytes] = []
        while True:
            passed = self._take(min(self._pass_over, len(self._held)))
            self._pass_over -= len(passed)
            if self._pass_over:
                return out
            if self._size is None and len(self._held) >= HEADER:
                self._begin(read_header(bytes(self._held[:HEADER])))
            elif self._size is not None and len(self._held) >= self._size:
                out.append(self._take(self._size))
                self._size = None
            else:
                return out

    def _begin(self, header: Header) -> None:
        """Decide whether the next message is kept or passed over."""
        size = HEADER + header.size
        if header.type_id not in CONTENTS:
            self.skipped += 1
            self._pass_over = size
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
