"""Wire protocol of an NDI Aurora: commands and replies, both protected by a CRC.

Pure functions over bytes. A damaged reply raises GarbledError; an intact reply that is an error
raises RefusedError. Source: NDI, "Aurora Application Program Interface Guide".
"""

from __future__ import annotations

import re
import struct
from itertools import pairwise

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.hardware.drivers.aurora_reply import (
    BROKEN_COIL,
    GarbledError,
    PortReading,
    RefusedError,
    Reply,
)

BX_HEADER = 6
"""Size of the start of a BX reply, which contains the length of the rest, bytes."""

_BX_START = b"\xc4\xa5"
_NUMBERS = re.compile(r"[+-]\d{5}" * 4 + r"[+-]\d{6}" * 3 + r"[+-]\d{5}")
_HANDLE = re.compile(
    r"([0-9A-F]{2})(?:(MISSING)|(DISABLED|UNOCCUPIED)|([+\-0-9]{51}))"
    r"(?:([0-9A-F]{8})([0-9A-F]{8}))?",
    re.IGNORECASE,
)
_FAR = 100.0  # m from the tracker, beyond which a position is invalid


def _table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
        table.append(byte)
    return tuple(table)


_CRC = _table()


def crc16(data: bytes) -> int:
    """CRC-16/ARC: x¹⁶ + x¹⁵ + x² + 1, reflected, with initial value zero.

    >>> f"{crc16(b'INIT:'):04X}"
    'E3A5'
    """
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _CRC[(crc ^ byte) & 0xFF]
    return crc


def frame_command(text: str) -> bytes:
    r"""Encode a command: text, its CRC in four hexadecimal digits, carriage return.

    >>> frame_command("TSTART:")
    b'TSTART:5423\r'
    """
    data = text.encode("ascii")
    return data + b"%04X\r" % crc16(data)


def parse_ascii(raw: bytes) -> str:
    r"""Check an ASCII reply, and return its text without CRC and carriage return.

    Raises:
        GarbledError: The CRC does not match.
        RefusedError: The reply is an error.

    >>> parse_ascii(b"OKAYA896\r")
    'OKAY'
    """
    body, crc = raw[:-5], raw[-5:-1]
    if raw[-1:] != b"\r" or crc.upper() != b"%04X" % crc16(body) or not body.isascii():
        raise GarbledError(f"A reply of the Aurora came damaged: {_shown(raw)}; check the cable.")
    text = body.decode("ascii")
    if re.fullmatch(r"ERROR[0-9A-Fa-f]{2}", text):
        raise RefusedError(int(text[5:], 16))
    return text


def parse_handles(text: str) -> list[int]:
    """Parse the handles of a PHSR reply: their count, then handle and status of each.

    Raises:
        GarbledError: The text is not such a list.

    >>> parse_handles("020A0010B001")
    [10, 11]
    """
    if not re.fullmatch(r"[0-9A-Fa-f]{2}([0-9A-Fa-f]{5})*", text):
        raise GarbledError(f"No list of handles: {text[:60]!r}; ask again.")
    handles = [int(text[k : k + 2], 16) for k in range(2, len(text), 5)]
    if len(handles) != int(text[:2], 16):
        raise GarbledError(
            f"{int(text[:2], 16)} handles announced, {len(handles)} came; ask again."
        )
    return handles


def parse_tx(raw: bytes) -> Reply:
    """Parse a TX reply, whose resolution is 0.01 mm and 1e-4 of a quaternion.

    Published clients of the device disagree whether a status and frame number follow DISABLED and
    UNOCCUPIED, so both forms are accepted.

    Raises:
        GarbledError: The reply is damaged.
        RefusedError: The reply is an error.
    """
    text = parse_ascii(raw)
    *lines, status = text[2:].split("\n")
    if not re.fullmatch(r"[0-9A-Fa-f]{2}", text[:2]) or len(lines) != int(text[:2], 16):
        raise GarbledError(f"A TX reply lacks lines: {_shown(raw)}; ask again.")
    if not re.fullmatch(r"[0-9A-Fa-f]{4}", status):
        raise GarbledError(f"A TX reply lacks the system's status: {_shown(raw)}; ask again.")
    return Reply(tuple(_tx_reading(line) for line in lines), int(status, 16))


def _tx_reading(line: str) -> PortReading:
    match = _HANDLE.fullmatch(line)
    if not match:
        raise GarbledError(f"No reading of a port: {line[:60]!r}; ask again.")
    handle, missing, absent, numbers, *tail = match.groups()
    status, number = (None if part is None else int(part, 16) for part in tail)
    if absent:
        return PortReading(int(handle, 16), absent.lower(), number, status)
    if number is None or status is None or (numbers and not _NUMBERS.fullmatch(numbers)):
        raise GarbledError(f"No reading of a port: {line[:60]!r}; ask again.")
    values = None
    if not missing:
        edges = [0, 6, 12, 18, 24, 31, 38, 45, 51]
        digits = [int(numbers[a:b]) for a, b in pairwise(edges)]
        values = np.array(digits) * np.repeat([1e-4, 1e-2, 1e-4], [4, 3, 1])
    return _reading(int(handle, 16), values, number, status)


def bx_length(header: bytes) -> int:
    """Number of bytes that follow the first six of a BX reply. Raises GarbledError."""
    if len(header) != BX_HEADER or header[:2] != _BX_START:
        raise GarbledError(f"No beginning of a BX reply: {_shown(header)}; ask again.")
    length, crc = struct.unpack("<HH", header[2:])
    if crc16(header[:4]) != crc:
        raise GarbledError(
            f"The beginning of a BX reply came damaged: {_shown(header)}; ask again."
        )
    return int(length) + 2


def parse_bx(raw: bytes) -> Reply:
    """Parse a BX reply, in single precision. Raises GarbledError."""
    if bx_length(raw[:BX_HEADER]) != len(raw) - BX_HEADER:
        raise GarbledError(f"A BX reply of {len(raw)} bytes states another length; ask again.")
    body = raw[BX_HEADER:-2]
    if crc16(body) != int.from_bytes(raw[-2:], "little"):
        raise GarbledError(f"A BX reply came damaged: {_shown(raw)}; check the cable.")
    try:
        return _bx_body(body)
    except (struct.error, IndexError):
        raise GarbledError(f"A BX reply ends too early: {_shown(raw)}; ask again.") from None


def _bx_body(body: bytes) -> Reply:
    at, ports = 1, []
    for _ in range(body[0]):
        handle, kind = body[at], body[at + 1]
        at += 2
        if kind == 0x04:
            ports.append(PortReading(handle, "disabled"))
            continue
        if kind not in (0x01, 0x02):
            raise GarbledError(f"Port {handle:02X} is in state {kind:02X}, unknown; ask again.")
        values = None
        if kind == 0x01:
            values = np.array(struct.unpack_from("<8f", body, at))
            at += 32
        status, number = struct.unpack_from("<II", body, at)
        at += 8
        ports.append(_reading(handle, values, number, status))
    (status,) = struct.unpack_from("<H", body, at)
    if at + 2 != len(body):
        raise GarbledError(f"A BX reply has {len(body) - at - 2} bytes too many; ask again.")
    return Reply(tuple(ports), status)


def _reading(handle: int, values: Array | None, number: int, status: int) -> PortReading:
    """Reading from [w, x, y, z, x mm, y mm, z mm, quality]; 'missing' without a valid pose."""
    # The tracker may continue to report poses of a broken coil; they are discarded.
    if values is None or status & BROKEN_COIL or not _is_pose(values):
        return PortReading(handle, "missing", number, status)
    pose = se3.pose(se3.rotation_from_quaternion(values[:4]), 1e-3 * values[4:7])
    return PortReading(handle, "valid", number, status, pose, float(values[7]))


def _is_pose(values: Array) -> bool:
    if not np.all(np.isfinite(values)):
        return False
    unit = abs(float(np.linalg.norm(values[:4])) - 1.0) < 0.01
    return unit and float(np.abs(values[4:7]).max()) < 1e3 * _FAR


def _shown(raw: bytes) -> str:
    return repr(raw if len(raw) <= 60 else raw[:57] + b"...")
