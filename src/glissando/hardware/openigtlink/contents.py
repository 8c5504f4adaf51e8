"""What messages say: a class a type, each with its bytes. Lengths are as on the wire.

The protocol leaves the unit of length to the peers; by custom it is the millimetre. Numbers are
float32 on the wire, big-endian, and stay as they came; `glissando.hardware.openigtlink.address`
converts them.
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

REFERENCE, TOOL_6D, TOOL_3D, TOOL_5D = 1, 2, 3, 4  # what a tool of TDATA measures
_TOOL = np.dtype([("name", "S20"), ("kind", "u1"), ("reserved", "u1"), ("columns", FLOAT, (4, 3))])
_POINT = struct.Struct(">64s32s4s3ff20s")
_STATUS = struct.Struct(">Hq20s")
_STRING = struct.Struct(">HH")
_SENSOR = struct.Struct(">BBQ")
_START = struct.Struct(">i32s")
_SCALARS = {2: "i1", 3: "u1", 4: "i2", 5: "u2", 6: "i4", 7: "u4", 10: "f4", 11: "f8", 13: "c16"}


class Content(Protocol):
    """The content of a message of one type."""

    type_id: ClassVar[str]

    def pack(self) -> bytes:
        """The content's bytes."""

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """The content of bytes. Raises MessageError."""


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
        """48 bytes."""
        return pack_pose(self.matrix)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 48 bytes."""
        _require(len(data) == POSE, cls.type_id, data)
        return cls(unpack_pose(data))


@dataclass(frozen=True)
class Position:
    """A position (3,), and a quaternion [x, y, z, w] (4,) if one was sent."""

    position: Array
    quaternion: Array | None = None
    type_id: ClassVar[str] = "POSITION"

    def pack(self) -> bytes:
        """12 or 28 bytes."""
        turn = np.zeros(0) if self.quaternion is None else self.quaternion
        return np.concatenate([self.position, turn]).astype(FLOAT).tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 12 bytes, or 28; of 24 the quaternion's w follows from its length."""
        _require(len(data) in (12, 24, 28), cls.type_id, data)
        numbers = floats(data)
        position, turn = numbers[:3], numbers[3:]
        if turn.size == 3:
            turn = np.append(turn, np.sqrt(max(0.0, 1.0 - float(turn @ turn))))
        return cls(position, turn if turn.size else None)


@dataclass(frozen=True)
class Tool:
    """A tool of a tracker: its name, what is measured of it (TOOL_6D, …), its pose (4, 4)."""

    name: str
    kind: int
    matrix: Array


@dataclass(frozen=True)
class TrackingData:
    """All tools of a tracker at one moment."""

    tools: tuple[Tool, ...]
    type_id: ClassVar[str] = "TDATA"

    def pack(self) -> bytes:
        """70 bytes a tool."""
        table = np.zeros(len(self.tools), _TOOL)
        table["name"] = [fixed_text(tool.name, 20) for tool in self.tools]
        table["kind"] = [tool.kind for tool in self.tools]
        for k, tool in enumerate(self.tools):
            table["columns"][k] = tool.matrix[:3].T
        return table.tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 70 bytes a tool."""
        _require(len(data) % _TOOL.itemsize == 0, cls.type_id, data)
        tools = []
        for name, kind, _, columns in np.frombuffer(data, _TOOL):
            tools.append(Tool(text_of(name), int(kind), unpack_pose(columns.tobytes())))
        return cls(tuple(tools))


@dataclass(frozen=True)
class Point:
    """A named point: position (3,), radius, group, colour [r, g, b, a], and who owns it."""

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
        """136 bytes a point."""
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
        """From 136 bytes a point."""
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
    """How a device is: code 1 is good, the protocol's list says of others; a name and a text."""

    code: int
    message: str = ""
    name: str = ""
    subcode: int = 0
    type_id: ClassVar[str] = "STATUS"

    def pack(self) -> bytes:
        """31 bytes and the text."""
        head = _STATUS.pack(self.code, self.subcode, fixed_text(self.name, 20))
        return head + self.message.encode() + b"\0"

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 31 bytes or more, the last of them zero."""
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
        """4 bytes and the text. Raises DeviceError when it is too long."""
        raw = self.text.encode()
        if len(raw) > 0xFFFF:
            raise DeviceError(f"A text of {len(raw)} bytes is too long for STRING; send less.")
        return _STRING.pack(self.encoding if self.text.isascii() else 106, len(raw)) + raw

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 4 bytes and as many as they state."""
        _require(len(data) >= _STRING.size, cls.type_id, data)
        encoding, length = _STRING.unpack_from(data)
        _require(len(data) == _STRING.size + length, cls.type_id, data)
        return cls(data[_STRING.size :].decode("utf-8", "replace"), encoding)


@dataclass(frozen=True)
class SensorValues:
    """Up to 255 numbers (N,) with a unit, which the protocol packs into 64 bits, and a status."""

    values: Array
    unit: int = 0
    status: int = 0
    type_id: ClassVar[str] = "SENSOR"

    def pack(self) -> bytes:
        """10 bytes, and 8 a number."""
        values = np.asarray(self.values, dtype=">f8")
        if values.size > 255:
            raise DeviceError(f"SENSOR holds 255 numbers, not {values.size}; send an NDARRAY.")
        return _SENSOR.pack(values.size, self.status, self.unit) + values.tobytes()

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 10 bytes and 8 a number."""
        _require(len(data) >= _SENSOR.size, cls.type_id, data)
        count, status, unit = _SENSOR.unpack_from(data)
        _require(len(data) == _SENSOR.size + 8 * count, cls.type_id, data)
        return cls(np.frombuffer(data, ">f8", offset=_SENSOR.size).astype(float), unit, status)


@dataclass(frozen=True)
class NumberArray:
    """An array of numbers of any shape, in the type it was sent."""

    values: NDArray[np.generic]
    type_id: ClassVar[str] = "NDARRAY"

    def pack(self) -> bytes:
        """Type and shape, then the numbers row by row."""
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
        """From type, shape and exactly as many numbers."""
        _require(len(data) >= 2 and data[0] in _SCALARS, cls.type_id, data)
        begin = 2 + 2 * data[1]
        _require(len(data) >= begin, cls.type_id, data)
        shape = np.frombuffer(data[2:begin], ">u2").tolist()
        kind, count = np.dtype(">" + _SCALARS[data[0]]), 1
        for side in shape:  # Python's numbers do not overflow
            count *= side
        _require(len(data) - begin == count * kind.itemsize, cls.type_id, data)
        try:
            values = np.frombuffer(data, kind, offset=begin).reshape(shape)
        except ValueError:  # numpy has fewer dimensions than the protocol, and sides overflow it
            raise MessageError(
                f"An NDARRAY of {len(shape)} sides, {max(shape)} the longest, cannot be held; send "
                f"one of fewer."
            ) from None
        return cls(values.astype(kind.newbyteorder("=")))


@dataclass(frozen=True)
class StartTracking:
    """Asks a tracker to send TDATA every `interval` ms in a frame it knows by name."""

    interval: int
    frame: str = ""
    type_id: ClassVar[str] = "STT_TDATA"

    def pack(self) -> bytes:
        """36 bytes."""
        return _START.pack(self.interval, fixed_text(self.frame, 32))

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """From 36 bytes."""
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
"""The contents that are read and written, by type."""
