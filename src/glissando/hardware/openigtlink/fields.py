"""Fields of messages: texts of fixed size, float32 numbers, poses; the error of all of them."""

from __future__ import annotations

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array

FLOAT = np.dtype(">f4")
POSE = 48  # bytes: three columns of a rotation, then a position


class MessageError(DeviceError):
    """Bytes are no OpenIGTLink message that can be read."""


def fixed_text(text: str, size: int) -> bytes:
    """A text as a field of `size` bytes. Raises DeviceError when it is longer."""
    raw = text.encode()
    if len(raw) > size:
        raise DeviceError(f"{text!r} has {len(raw)} bytes, its field {size}; shorten it.")
    return raw.ljust(size, b"\0")


def text_of(field: bytes) -> str:
    """The text of a field, up to its first zero byte."""
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")


def floats(data: bytes) -> Array:
    """The float32 numbers (M,) that bytes are, NaN and infinity as they come."""
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        return np.frombuffer(data, FLOAT).astype(float)


def pack_pose(pose: Array) -> bytes:
    """The 48 bytes of a pose (4, 4): columns of the rotation, then the position."""
    return np.asarray(pose)[:3].T.astype(FLOAT).tobytes()


def unpack_pose(data: bytes) -> Array:
    """The pose (4, 4) of 48 bytes."""
    out = np.eye(4)
    out[:3] = floats(data).reshape(4, 3).T
    return out
