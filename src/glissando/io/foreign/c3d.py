"""Import of c3d files: labelled points of motion capture.

Every size that a file states is checked against the file's length before memory is allocated.
Source: Motion Lab Systems, "The C3D File Format: A Technical User Guide" (c3d.org).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from glissando.errors import RecordingError
from glissando.geometry.se3 import Array
from glissando.io.foreign.tracks import LENGTHS, Track, plain_name
from glissando.io.plain_file import require_plain

_BLOCK = 512  # bytes
_INTEL, _DEC, _SGI = 84, 85, 86  # types of the processor that wrote the file
_SIZES = {-1: 1, 1: 1, 2: 2, 4: 4}  # bytes of a parameter's type; -1 is text
_MANY = 65535  # largest frame number that the header can state


def read_c3d(path: Path, rate: float | None) -> list[Track]:
    """Read the points of a c3d file as positions; a residual below zero marks a gap.

    Args:
        path: c3d file.
        rate: Frames a second; None to take the file's.

    Raises:
        RecordingError: The file cannot be read, is truncated, or states no units or rate.
    """
    try:
        require_plain(path)
        file = _File(path.read_bytes())
    except OSError as problem:
        raise RecordingError(f"{path} cannot be read ({problem.strerror}).") from None
    except (ValueError, IndexError, OverflowError, struct.error) as problem:
        raise RecordingError(f"{path.name} cannot be read as c3d ({problem}).") from None
    units, hz = file.text("POINT", "UNITS").strip().lower(), rate or file.rate
    if units not in LENGTHS or not 0.0 < hz < 1e6:
        raise RecordingError(
            f"{path.name}: points at {hz:g} Hz in {units[:20]!r}; give POINT:UNITS as one of "
            f"{', '.join(LENGTHS)}, and the rate with --rate HZ where there is none."
        )
    time = (file.first - 1 + np.arange(file.frames)) / hz
    tracks = []
    for label, points, seen in zip(file.labels(), *file.points(), strict=False):
        values, missing = LENGTHS[units] * points[seen], int(np.sum(~seen))
        tracks.append(Track(plain_name(label), "position", time[seen], values, missing))
    if not tracks:
        raise RecordingError(f"{path.name} holds no labelled points; label some and save again.")
    return tracks


@dataclass(frozen=True)
class _Parameter:
    kind: int
    shape: tuple[int, ...]
    data: bytes


class _File:
    """A c3d file's header, its parameters by (group, name), and its points."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _BLOCK or data[1] != 0x50:
            raise ValueError("its first block is not that of a c3d file")
        at = _BLOCK * (data[0] - 1)
        self._data, self._processor = data, data[at + 3]
        if self._processor not in (_INTEL, _DEC, _SGI):
            raise ValueError(f"it was written by a processor of type {self._processor}")
        self._order = ">" if self._processor == _SGI else "<"
        self.parameters = dict(self._parameters(at + 4))
        header = np.frombuffer(data, f"{self._order}u2", 12)
        self._points, self._analog, self.first, last = (int(n) for n in header[1:5])
        self._scale, header_rate = (float(self._floats(header[k : k + 2])[0]) for k in (6, 10))
        self._begin = _BLOCK * (int(header[8]) - 1)
        rate = self.number("POINT", "RATE")
        self.rate = header_rate if rate is None else rate
        self.frames = self._count(self.first, last)
        words_per_frame = 4 * self._points + self._analog
        stored = max(len(data) - self._begin, 0) // max(
            words_per_frame * (4 if self._scale < 0 else 2), 1
        )
        if self._begin < _BLOCK or self.frames < 1 or stored < self.frames:
            raise ValueError(
                f"it announces {self.frames} frames of {self._points} points and holds {stored}"
            )

    def _count(self, first: int, last: int) -> int:
        """Number of frames, from parameters of the file if it is too large for the header."""
        if last < _MANY:
            return last - first + 1
        long, actual = self.number("POINT", "LONG_FRAMES"), ("TRIAL", "ACTUAL_END_FIELD")
        if long is not None:
            return int(long)
        if actual in self.parameters:
            low, high = np.frombuffer(self.parameters[actual].data, f"{self._order}u2", 2)
            return (int(high) << 16) + int(low) - first + 1
        return last - first + 1

    def _floats(self, words: Array) -> Array:
        """Pairs of 16-bit words as float32; DEC's have swapped words and a biased exponent."""
        if self._processor == _DEC:
            return words.reshape(-1, 2)[:, ::-1].copy().view("<f4").ravel() / 4.0
        return words.copy().view(f"{self._order}f4")

    def _parameters(self, at: int) -> Iterator[tuple[tuple[str, str], _Parameter]]:
        groups: dict[int, str] = {}
        parameters: list[tuple[int, str, _Parameter]] = []
        while (length := abs(_signed(self._data[at]))) != 0:
            identity = _signed(self._data[at + 1])
            name = self._data[at + 2 : at + 2 + length].decode("latin-1").upper()
            at += 2 + length
            (step,) = struct.unpack_from(f"{self._order}H", self._data, at)
            if identity < 0:
                groups[-identity] = name
            else:
                parameters.append((identity, name, self._parameter(at + 2)))
            if step == 0:
                break
            at += step
        for identity, name, parameter in parameters:
            yield (groups.get(identity, ""), name), parameter

    def _parameter(self, at: int) -> _Parameter:
        kind, dimensions = _signed(self._data[at]), self._data[at + 1]
        shape = tuple(self._data[at + 2 : at + 2 + dimensions])
        if kind not in _SIZES:
            raise ValueError(f"a parameter is of type {kind}")
        begin, size = at + 2 + dimensions, _SIZES[kind]
        for extent in shape:
            size *= extent
        if begin + size > len(self._data):
            raise ValueError(f"a parameter of {size} bytes goes beyond its end")
        return _Parameter(kind, shape, self._data[begin : begin + size])

    def text(self, group: str, name: str) -> str:
        """First text of a parameter; empty if there is no such parameter."""
        return "".join(self._texts(group, name)[:1])

    def _texts(self, group: str, name: str) -> list[str]:
        parameter = self.parameters.get((group, name))
        if parameter is None or parameter.kind != -1 or not parameter.data:
            return []
        size = parameter.shape[0] if parameter.shape else 1
        cut = range(0, len(parameter.data), size)
        return [parameter.data[k : k + size].decode("utf-8", "replace").strip("\0 ") for k in cut]

    def number(self, group: str, name: str) -> float | None:
        """First number of a parameter; None if there is no such parameter."""
        parameter = self.parameters.get((group, name))
        if parameter is None or parameter.kind not in (2, 4) or not parameter.data:
            return None
        if parameter.kind == 2:
            return float(np.frombuffer(parameter.data, f"{self._order}i2", 1)[0])
        return float(self._floats(np.frombuffer(parameter.data, f"{self._order}u2", 2))[0])

    def labels(self) -> list[str]:
        """Labels of the points; those beyond 255 are in LABELS2, LABELS3 and so on."""
        labels: list[str] = []
        for k in range(1, 256):
            more = self._texts("POINT", "LABELS" if k == 1 else f"LABELS{k}")
            labels += more
            if not more:
                break
        return labels[: self._points]

    def points(self) -> tuple[Array, Array]:
        """Positions (P, F, 3) in the file's unit, and whether each (P, F) was measured."""
        words_per_frame, is_float = 4 * self._points + self._analog, self._scale < 0.0
        count = self.frames * words_per_frame * (1 + is_float)
        raw = np.frombuffer(self._data, f"{self._order}u2", count, self._begin)
        with np.errstate(over="ignore", invalid="ignore"):
            numbers = self._floats(raw) if is_float else self._scale * raw.view(f"{self._order}i2")
            frames = np.asarray(numbers, float).reshape(self.frames, words_per_frame)[
                :, : 4 * self._points
            ]
            table = frames.reshape(self.frames, self._points, 4).swapaxes(0, 1)
            seen = np.all(np.abs(table[..., :3]) < 1e30, axis=-1) & (table[..., 3] >= 0.0)
        return table[..., :3], seen


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte
