"""Dynamixel Protocol 2.0: packets with byte stuffing and CRC, and a bus of servos that answers.

Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

BROADCAST = 0xFE
ALERT = 0x80  # bit of a status packet's error: a hardware error is pending
_HEADER = b"\xff\xff\xfd\x00"
_LONGEST = 1024  # bytes from the instruction on; longer is taken for noise
_PAUSE = 0.1  # s between bytes after which a packet is given up [inferred]


class Do(IntEnum):
    """Instructions."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    BULK_READ = 0x92
    BULK_WRITE = 0x93


class Fault(IntEnum):
    """What a status packet's error may say."""

    NONE = 0
    RESULT = 1
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


Reply = tuple[int, bytes]
"""A status packet's error and parameters."""


class Answers(Protocol):
    """A servo, as the bus sees it."""

    @property
    def id(self) -> int:
        """Its address on the bus."""

    def execute(self, instruction: int, parameters: bytes, now: float) -> Reply | None:
        """What the servo answers to an instruction at a time; None when it is silent."""


@dataclass(frozen=True)
class Packet:
    """One instruction as it came; `sound` is false when its CRC is wrong."""

    id: int
    instruction: int
    parameters: bytes
    sound: bool = True


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x8005 if value & 0x8000 else 0)
        table.append(value & 0xFFFF)
    return table


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, not reflected, from zero.

    >>> hex(crc16(bytes.fromhex("ffff fd00 01 0300 01")))
    '0x4e19'
    """
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _CRC[value >> 8 ^ byte]
    return value


def packed(identity: int, instruction: int, parameters: bytes = b"") -> bytes:
    """A whole packet: header, stuffed instruction and parameters, CRC.

    >>> packed(1, Do.PING).hex(" ")
    'ff ff fd 00 01 03 00 01 19 4e'
    """
    body = bytes([instruction, *parameters]).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = _HEADER + bytes([identity]) + (len(body) + 2).to_bytes(2, "little")
    return head + body + crc16(head + body).to_bytes(2, "little")


class Parser:
    """Finds packets in a stream of bytes, whatever else is in it."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._last = 0.0

    def feed(self, data: bytes, now: float) -> Iterator[Packet]:
        """The packets that are complete with these bytes, which came at a time."""
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
            # A bad packet may be a bad length: look for the next header inside it.
            del stream[: len(whole) if sound else 4]
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            return Packet(whole[4], body[0], body[1:], sound)


class Bus:
    """Servos on one line: hands instructions out and collects status packets in their order."""

    def __init__(self, servos: Sequence[Answers]) -> None:
        self.servos = servos
        self._parser = Parser()

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Status packets that answer these bytes; instructions with a bad CRC do nothing."""
        packets = self._parser.feed(data, now)
        return [status for packet in packets for status in self._answers(packet, now)]

    def _answers(self, packet: Packet, now: float) -> Iterator[bytes]:
        if packet.instruction == Do.STATUS:
            return
        if packet.id == BROADCAST:
            if packet.sound:
                yield from self._broadcast(packet, now)
            return
        servo = self._servo(packet.id)
        if servo is None:
            return
        if packet.sound:
            reply = servo.execute(packet.instruction, packet.parameters, now)
        else:
            reply = (Fault.CRC, b"")
        if reply:
            yield _status(packet.id, reply)

    def _broadcast(self, packet: Packet, now: float) -> Iterator[bytes]:
        words = packet.parameters
        if packet.instruction in (Do.SYNC_READ, Do.BULK_READ):
            yield from self._read_all(_reads(packet.instruction, words), now)
        elif packet.instruction in (Do.SYNC_WRITE, Do.BULK_WRITE):
            for identity, parameters in _writes(packet.instruction, words):
                if servo := self._servo(identity):
                    servo.execute(Do.WRITE, parameters, now)
        else:
            for servo in sorted(self.servos, key=lambda servo: servo.id):
                identity = servo.id
                reply = servo.execute(packet.instruction, words, now)
                if packet.instruction == Do.PING and reply:
                    yield _status(identity, reply)

    def _read_all(self, wanted: Sequence[tuple[int, bytes]], now: float) -> Iterator[bytes]:
        for identity, parameters in wanted:
            servo = self._servo(identity)
            reply = servo.execute(Do.READ, parameters, now) if servo else None
            if reply is None:  # those after it wait for its packet in vain [inferred]
                return
            yield _status(identity, reply)

    def _servo(self, identity: int) -> Answers | None:
        return next((servo for servo in self.servos if servo.id == identity), None)


def _status(identity: int, reply: Reply) -> bytes:
    error, parameters = reply
    return packed(identity, Do.STATUS, bytes([error]) + parameters)


def _reads(instruction: int, words: bytes) -> list[tuple[int, bytes]]:
    if instruction == Do.SYNC_READ:
        return [(identity, words[:4]) for identity in words[4:]] if len(words) >= 4 else []
    return [(words[k], words[k + 1 : k + 5]) for k in range(0, len(words) - 4, 5)]


def _writes(instruction: int, words: bytes) -> Iterator[tuple[int, bytes]]:
    """Pairs of an identity and the parameters of its write: address, then data."""
    if instruction == Do.SYNC_WRITE:
        size = int.from_bytes(words[2:4], "little")
        for k in range(4, len(words) - size, 1 + size):
            yield words[k], words[:2] + words[k + 1 : k + 1 + size]
        return
    k = 0
    while k + 5 <= len(words):
        size = int.from_bytes(words[k + 3 : k + 5], "little")
        if k + 5 + size > len(words):
            return
        yield words[k], words[k + 1 : k + 3] + words[k + 5 : k + 5 + size]
        k += 5 + size
