"""Encoding of an Aurora's replies: text, TX and BX."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.geometry.se3 import Array


@dataclass(frozen=True)
class PortReport:
    """Content of a reply for one handle.

    Attributes:
        handle: The port's handle.
        status: The port's status bits.
        values: Quaternion [w, x, y, z], position in mm, quality (8,); None for a missing coil.
        condition: 'DISABLED' or 'UNOCCUPIED', sent in place of values, or ''.
    """

    handle: int
    status: int
    values: Array | None
    condition: str = ""


def crc(data: bytes) -> int:
    """CRC-16/ARC, computed bit by bit."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 * (value & 1)
    return value


def text_reply(text: str) -> bytes:
    """Encode text, CRC and carriage return."""
    body = text.encode("ascii")
    return body + f"{crc(body):04X}\r".encode()


def tx_reply(reports: Sequence[PortReport], frame: int, status: int, bare: bool) -> bytes:
    """Encode a TX reply; `bare` omits status and frame number of absent coils."""
    text = f"{len(reports):02X}"
    for port in reports:
        text += f"{port.handle:02X}{port.condition or _digits(port.values)}"
        if not (bare and port.condition):
            text += f"{port.status:08X}{frame:08X}"
        text += "\n"
    return text_reply(text + f"{status:04X}")


def _digits(values: Array | None) -> str:
    if values is None:
        return "MISSING"
    whole = np.rint(values / np.repeat([1e-4, 1e-2, 1e-4], [4, 3, 1])).astype(int)
    widths = [5] * 4 + [6] * 3 + [5]
    return "".join(
        f"{np.clip(number, 1 - 10**width, 10**width - 1):+0{width + 1}d}"
        for number, width in zip(whole, widths, strict=True)
    )


def bx_reply(reports: Sequence[PortReport], frame: int, status: int) -> bytes:
    """Encode a BX reply: header with its CRC, body with its own."""
    body = bytes([len(reports)])
    for port in reports:
        kind = 0x04 if port.condition else 0x02 if port.values is None else 0x01
        body += bytes([port.handle, kind])
        if port.values is not None and not port.condition:
            body += struct.pack("<8f", *port.values)
        if not port.condition:
            body += struct.pack("<II", port.status, frame)
    body += struct.pack("<H", status)
    head = b"\xc4\xa5" + struct.pack("<H", len(body))
    return head + struct.pack("<H", crc(head)) + body + struct.pack("<H", crc(body))
