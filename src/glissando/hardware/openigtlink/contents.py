"""Contents of messages: a class for each type, with its encoding. Lengths are as on the wire.

The protocol leaves the unit of length to the peers; by custom it is the millimetre. Numbers are
big-endian float32 on the wire, and are not converted here but by
`glissando.hardware.openigtlink.address`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array
from glissando.hardware.openigtlink.fields import (
    FLOAT,
    POSE,
    MessageError,
    fixed_text,
    floats,
    pack_pose,
    text_of,
    unpack_pose,
)
from glissando.hardware.openigtlink.polydata import PolyData

REFERENCE, TOOL_6D, TOOL_3D, TOOL_5D = 1, 2, 3, 4  # kinds of tools in TDATA
_TOOL = np.dtype([("name", "S20"), ("kind", "u1"), ("reserved", "u1"), ("columns", FLOAT, (4, 3))])
_POINT = struct.Struct(">64s32s4s3ff20s")
_STATUS = struct.Struct(">Hq20s")
_STRING = struct.Struct(">HH")
_SENSOR = struct.Struct(">BBQ")
_START = struct.Struct(">i32s")
_SCALARS = {2: "i1", 3: "u1", 4: "i2", 5: "u2", 6: "i4", 7: "u4", 10: "f4", 11: "f8", 13: "c16"}


class Content(Protocol):
    """Content of a message of one type."""

    type_id: ClassVar[str]

    def pack(self) -> bytes:
        """Encode the content."""

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode the content. Raises MessageError."""


def _require(good: bool, kind: str, data: bytes) -> None:
    if not good:
        raise MessageError(
            f"A {kind} content of {len(data)} bytes contradicts the protocol; check the sender."
        )


@dataclass(frozen=True)
class Transform:
    """A pose (4, 4)."""

    matrix: Array
    type_id: ClassVar[str] = "TRANSFORM"

    def pack(self) -> bytes:
        """Encode in 48 bytes."""
        return pack_pose(self.matrix)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 48 bytes."""
        _require(len(data) == POSE, cls.type_id, data)
        return cls(unpack_pose(data))


@dataclass(frozen=True)
class Position:
    """A position (3,), and a quaternion [x, y, z, w] (4,) if one was sent."""

    position: Array
    quaternion: Array | None = None
    type_id: ClassVar[str] = "POSITION"

    def pack(self) -> bytes:
        """Encode in 12 or 28 bytes."""
        turn = np.zeros(0) if self.quaternion is None else self.quaternion
        return np.concatenate([self.position, turn]).astype(FLOAT).tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 12 or 28 bytes; in 24 bytes, w of the unit quaternion is omitted."""
        _require(len(data) in (12, 24, 28), cls.type_id, data)
        numbers = floats(data)
        position, turn = numbers[:3], numbers[3:]
        if turn.size == 3:
            turn = np.append(turn, np.sqrt(max(0.0, 1.0 - float(turn @ turn))))
        return cls(position, turn if turn.size else None)


@dataclass(frozen=True)
class Tool:
    """A tool of a tracker: its name, its kind (TOOL_6D, …), and its pose (4, 4)."""

    name: str
    kind: int
    matrix: Array


@dataclass(frozen=True)
class TrackingData:
    """All tools of a tracker at one instant."""

    tools: tuple[Tool, ...]
    type_id: ClassVar[str] = "TDATA"

    def pack(self) -> bytes:
        """Encode in 70 bytes for each tool."""
        table = np.zeros(len(self.tools), _TOOL)
        table["name"] = [fixed_text(tool.name, 20) for tool in self.tools]
        table["kind"] = [tool.kind for tool in self.tools]
        for k, tool in enumerate(self.tools):
            table["columns"][k] = tool.matrix[:3].T
        return table.tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 70 bytes for each tool."""
        _require(len(data) % _TOOL.itemsize == 0, cls.type_id, data)
        tools = []
        for name, kind, _, columns in np.frombuffer(data, _TOOL):
            tools.append(Tool(text_of(name), int(kind), unpack_pose(columns.tobytes())))
        return cls(tuple(tools))


@dataclass(frozen=True)
class Point:
    """A named point: position (3,), radius, group, colour [r, g, b, a], and owner."""

    name: str
    position: Array
    radius: float = 0.0
    group: str = ""
    rgba: tuple[int, int, int, int] = (255, 255, 255, 255)
    owner: str = ""


@dataclass(frozen=True)
class Points:
    """A list of points."""

    points: tuple[Point, ...]
    type_id: ClassVar[str] = "POINT"

    def pack(self) -> bytes:
        """Encode in 136 bytes for each point."""
        out = []
        for p in self.points:
            name, group, owner = (
                fixed_text(*each) for each in ((p.name, 64), (p.group, 32), (p.owner, 20))
            )
            place = [*map(float, p.position), float(p.radius)]
            out.append(_POINT.pack(name, group, bytes(p.rgba), *place, owner))
        return b"".join(out)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 136 bytes for each point."""
        _require(len(data) % _POINT.size == 0, cls.type_id, data)
        return cls(
            tuple(
                Point(
                    text_of(n), np.array(xyz), radius, text_of(group), tuple(rgba), text_of(owner)
                )
                for n, group, rgba, *xyz, radius, owner in _POINT.iter_unpack(data)
            )
        )


@dataclass(frozen=True)
class Status:
    """Status of a device: code (1 is good, others as in the protocol), name of the error, text."""

    code: int
    message: str = ""
    name: str = ""
    subcode: int = 0
    type_id: ClassVar[str] = "STATUS"

    def pack(self) -> bytes:
        """Encode in 31 bytes and the text."""
        head = _STATUS.pack(self.code, self.subcode, fixed_text(self.name, 20))
        return head + self.message.encode() + b"\0"

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 31 bytes or more, of which the last is zero."""
        _require(len(data) > _STATUS.size and data[-1] == 0, cls.type_id, data)
        code, subcode, name = _STATUS.unpack_from(data)
        return cls(code, text_of(data[_STATUS.size :]), text_of(name), subcode)


@dataclass(frozen=True)
class Text:
    """A text of up to 65535 bytes, with its character set (3 is ASCII, 106 is UTF-8)."""

    text: str
    encoding: int = 3
    type_id: ClassVar[str] = "STRING"

    def pack(self) -> bytes:
        """Encode in 4 bytes and the text. Raises DeviceError if it is too long."""
        raw = self.text.encode()
        if len(raw) > 0xFFFF:
            raise DeviceError(f"A text of {len(raw)} bytes is too long for STRING; send less.")
        return _STRING.pack(self.encoding if self.text.isascii() else 106, len(raw)) + raw

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 4 bytes and the number of bytes that they state."""
        _require(len(data) >= _STRING.size, cls.type_id, data)
        encoding, length = _STRING.unpack_from(data)
        _require(len(data) == _STRING.size + length, cls.type_id, data)
        return cls(data[_STRING.size :].decode("utf-8", "replace"), encoding)


@dataclass(frozen=True)
class SensorValues:
    """Up to 255 numbers (N,) with a unit, encoded in 64 bits by the protocol, and a status."""

    values: Array
    unit: int = 0
    status: int = 0
    type_id: ClassVar[str] = "SENSOR"

    def pack(self) -> bytes:
        """Encode in 10 bytes, and 8 for each number."""
        values = np.asarray(self.values, dtype=">f8")
        if values.size > 255:
            raise DeviceError(f"SENSOR holds 255 numbers, not {values.size}; send an NDARRAY.")
        return _SENSOR.pack(values.size, self.status, self.unit) + values.tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 10 bytes, and 8 for each number."""
        _require(len(data) >= _SENSOR.size, cls.type_id, data)
        count, status, unit = _SENSOR.unpack_from(data)
        _require(len(data) == _SENSOR.size + 8 * count, cls.type_id, data)
        return cls(np.frombuffer(data, ">f8", offset=_SENSOR.size).astype(float), unit, status)


@dataclass(frozen=True)
class NumberArray:
    """An array of numbers of any shape, in the type of the message."""

    values: NDArray[np.generic]
    type_id: ClassVar[str] = "NDARRAY"

    def pack(self) -> bytes:
        """Encode type and shape, then the numbers in row-major order."""
        values = np.asarray(self.values)
        code = next((c for c, name in _SCALARS.items() if np.dtype(name) == values.dtype), 0)
        if not code or values.ndim > 255 or max(values.shape, default=0) > 0xFFFF:
            raise DeviceError(
                f"An array {values.shape} of {values.dtype} has no place in NDARRAY; give "
                f"{', '.join(_SCALARS.values())}, 65535 a side at most."
            )
        shape = np.array(values.shape, dtype=">u2").tobytes()
        return bytes([code, values.ndim]) + shape + values.astype(">" + _SCALARS[code]).tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode type, shape, and exactly as many numbers."""
        _require(len(data) >= 2 and data[0] in _SCALARS, cls.type_id, data)
        begin = 2 + 2 * data[1]
        _require(len(data) >= begin, cls.type_id, data)
        shape = np.frombuffer(data[2:begin], ">u2").tolist()
        kind, count = np.dtype(">" + _SCALARS[data[0]]), 1
        for side in shape:  # Python's integers do not overflow
            count *= side
        _require(len(data) - begin == count * kind.itemsize, cls.type_id, data)
        try:
            values = np.frombuffer(data, kind, offset=begin).reshape(shape)
        except ValueError:  # numpy allows fewer dimensions than the protocol; sizes may overflow
            raise MessageError(
                f"An NDARRAY of {len(shape)} sides, {max(shape)} the longest, cannot be held; send "
                f"one of fewer."
            ) from None
        return cls(values.astype(kind.newbyteorder("=")))


@dataclass(frozen=True)
class StartTracking:
    """Request to a tracker to send TDATA every `interval` ms in a frame given by name."""

    interval: int
    frame: str = ""
    type_id: ClassVar[str] = "STT_TDATA"

    def pack(self) -> bytes:
        """Encode in 36 bytes."""
        return _START.pack(self.interval, fixed_text(self.frame, 32))

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode 36 bytes."""
        _require(len(data) == _START.size, cls.type_id, data)
        interval, frame = _START.unpack(data)
        return cls(interval, text_of(frame))


CONTENTS: dict[str, type[Content]] = {
    kind.type_id: kind
    for kind in (
        Transform, Position, TrackingData, Points, Status, Text, SensorValues, NumberArray,
        StartTracking, PolyData,
    )
}  # fmt: skip
"""Classes of the supported contents, by type."""
