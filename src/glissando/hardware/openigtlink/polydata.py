"""POLYDATA: a mesh of points, cells and attributes, for mesh viewers."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array
from glissando.hardware.openigtlink.fields import MessageError, floats

_HEADER = struct.Struct(">10I")
_ATTRIBUTE = struct.Struct(">BBI")
_SCALAR = 0
_WIDTH = {1: 3, 2: 3, 3: 9, 4: 4}  # components of a vector, normal, tensor and colour
_LONGEST = 255  # largest size of an attribute's name, bytes
_MOST = 64  # largest number of attributes

Cells = tuple[NDArray[np.integer], ...]
"""Cells of one kind, each given by the indices of its points."""


@dataclass(frozen=True)
class Attribute:
    """Values (M, C) at points or cells, with name and kind (0 is a scalar of C components)."""

    name: str
    values: Array
    kind: int = _SCALAR


@dataclass(frozen=True)
class PolyData:
    """A mesh.

    Attributes:
        points: Points (M, 3), in the unit of length of the connection.
        vertices: Cells that are points.
        lines: Cells that are polylines.
        polygons: Cells that are polygons.
        strips: Cells that are triangle strips.
        attributes: Values at the points or at the cells, according to their number.
    """

    points: Array
    vertices: Cells = ()
    lines: Cells = ()
    polygons: Cells | NDArray[np.integer] = ()
    strips: Cells = ()
    attributes: tuple[Attribute, ...] = field(default=())
    type_id: ClassVar[str] = "POLYDATA"

    def pack(self) -> bytes:
        """Encode header, points, cells of each kind, and attributes.

        Raises:
            DeviceError: There are too many attributes, or a name is too long.
        """
        points = np.asarray(self.points, dtype=">f4")
        kinds = self.vertices, self.lines, self.polygons, self.strips
        cells = [_pack_cells(kind) for kind in kinds]
        sizes = [n for kind, raw in zip(kinds, cells, strict=True) for n in (len(kind), len(raw))]
        head = _HEADER.pack(len(points), *sizes, len(self.attributes))
        return b"".join([head, points.tobytes(), *cells, self._pack_attributes()])

    def _pack_attributes(self) -> bytes:
        names = b"".join(a.name.encode() + b"\0" for a in self.attributes)
        longest = max((len(a.name.encode()) for a in self.attributes), default=0)
        if len(self.attributes) > _MOST or longest > _LONGEST:
            raise DeviceError(
                f"POLYDATA takes {_MOST} attributes of {_LONGEST} bytes a name, not "
                f"{len(self.attributes)} of up to {longest}; send fewer, or shorten them."
            )
        heads, data = [], []
        for a in self.attributes:
            values = np.asarray(a.values, dtype=">f4").reshape(len(a.values), -1)
            heads.append(_ATTRIBUTE.pack(a.kind, values.shape[1], len(values)))
            data.append(values.tobytes())
        return b"".join([*heads, names, b"\0" * (len(names) % 2), *data])

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Decode header, points, cells and attributes, which must fill the bytes exactly."""
        rest = _Bytes(data)
        count, *sizes, attributes = _HEADER.unpack(rest.take(_HEADER.size))
        points = floats(rest.take(12 * count)).reshape(count, 3)
        pairs = zip(sizes[::2], sizes[1::2], strict=True)  # number and bytes of a kind of cell
        cells = [_unpack_cells(number, rest.take(size), count) for number, size in pairs]
        values = _unpack_attributes(rest, attributes)
        rest.require_end()
        return cls(points, cells[0], cells[1], cells[2], cells[3], values)


class _Bytes:
    """A reader of bytes from the front, which checks that enough are left."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, count: int) -> bytes:
        end = self._at + count
        if end > len(self._data):
            raise MessageError(
                f"POLYDATA states {end} bytes or more and has {len(self._data)}; check the sender."
            )
        out, self._at = self._data[self._at : end], end
        return out

    def take_text(self) -> bytes:
        end = self._data.find(b"\0", self._at, self._at + _LONGEST + 1)
        if end < 0:
            raise MessageError("A POLYDATA attribute's name has no end; check the sender.")
        return self.take(end + 1 - self._at)[:-1]

    def require_end(self) -> None:
        if self._at != len(self._data):
            raise MessageError(
                f"{len(self._data) - self._at} bytes follow the POLYDATA; check the sender."
            )


def _pack_cells(cells: Cells | NDArray[np.integer]) -> bytes:
    """Encode the number of points of each cell, followed by their indices."""
    if not len(cells):
        return b""
    if isinstance(cells, np.ndarray):  # cells of one size: without a loop
        table = np.empty((len(cells), 1 + cells.shape[1]), ">u4")
        table[:, 0], table[:, 1:] = cells.shape[1], cells
        return table.tobytes()
    flat = [np.concatenate([[len(cell)], cell]) for cell in cells]
    return np.concatenate(flat).astype(">u4").tobytes()


def _unpack_cells(number: int, data: bytes, points: int) -> Cells:
    if len(data) % 4 or number > len(data) // 4:
        raise MessageError(f"{number} POLYDATA cells do not fit {len(data)} bytes.")
    flat = np.frombuffer(data, ">u4").astype(np.int64)
    out, at = [], 0
    for _ in range(number):
        size = int(flat[at]) if at < flat.size else 0
        cell = flat[at + 1 : at + 1 + size]
        if at >= flat.size or cell.size < size or np.any(cell >= points):
            raise MessageError("A POLYDATA cell names points that are not there.")
        out.append(cell)
        at += 1 + size
    if at != flat.size:
        raise MessageError(f"{flat.size - at} numbers follow the POLYDATA cells.")
    return tuple(out)


def _unpack_attributes(rest: _Bytes, count: int) -> tuple[Attribute, ...]:
    if count > _MOST:
        raise MessageError(f"POLYDATA with {count} attributes is refused; {_MOST} are read.")
    heads = [_ATTRIBUTE.unpack(rest.take(_ATTRIBUTE.size)) for _ in range(count)]
    names = [rest.take_text() for _ in range(count)]
    if sum(len(name) + 1 for name in names) % 2:
        rest.take(1)
    out = []
    for (kind, components, number), name in zip(heads, names, strict=True):
        width = _WIDTH.get(kind, components)
        if not width:
            raise MessageError("A POLYDATA attribute has no components; check the sender.")
        raw = floats(rest.take(4 * width * number))
        out.append(Attribute(name.decode("utf-8", "replace"), raw.reshape(-1, width), kind))
    return tuple(out)
