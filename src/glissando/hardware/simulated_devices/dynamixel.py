"""Dynamixel Protocol 2.0: packets with byte stuffing and CRC, and their detection in a stream.

Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

ALERT = 0x80  # bit of a status packet's error: a hardware error is pending
_HEADER = b"\xff\xff\xfd\x00"
_LONGEST = 1024  # bytes from the instruction on; a longer packet is noise
_PAUSE = 0.1  # s between bytes after which an incomplete packet is discarded [inferred]


class Do(IntEnum):
    """Instructions that the simulated servo supports, and STATUS, its answer."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55


class Fault(IntEnum):
    """Error numbers of a status packet."""

    NONE = 0
    RESULT = 1
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True)
class Packet:
    """One packet as received; `sound` is false if its CRC is wrong."""

    id: int
    instruction: int
    parameters: bytes
    sound: bool = True


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, not reflected, with initial value zero.

    >>> hex(crc16(bytes.fromhex("ffff fd00 01 0300 01")))
    '0x4e19'
    """
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x8005 * (value >> 15)) & 0xFFFF
    return value


def packed(identity: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Encode a packet: header, stuffed instruction and parameters, CRC.

    >>> packed(1, Do.PING).hex(" ")
    'ff ff fd 00 01 03 00 01 19 4e'
    """
    body = bytes([instruction, *parameters]).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = _HEADER + bytes([identity]) + (len(body) + 2).to_bytes(2, "little")
    return head + body + crc16(head + body).to_bytes(2, "little")


class Parser:
    """Detects packets in a stream of bytes that may contain noise."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._last = 0.0

    def feed(self, data: bytes, now: float) -> Iterator[Packet]:
        """Yield packets that are complete with these bytes, received at `now` s."""
        if now - self._last > _PAUSE:
            self._bytes.clear()
        self._last = now
        self._bytes += data
        while (packet := self._next()) is not None:
            yield packet

    def _next(self) -> Packet | None:
        stream = self._bytes
        while True:
            start = stream.find(_HEADER)
            del stream[: start if start >= 0 else max(len(stream) - 3, 0)]
            if start < 0 or len(stream) < 7:
                return None
            length = int.from_bytes(stream[5:7], "little")
            if not 3 <= length <= _LONGEST:
                del stream[:4]
                continue
            if len(stream) < 7 + length:
                return None
            whole = bytes(stream[: 7 + length])
            sound = crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little")
            # The length of a bad packet may be wrong: search for the next header inside it.
            del stream[: len(whole) if sound else 4]
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            return Packet(whole[4], body[0], body[1:], sound)
