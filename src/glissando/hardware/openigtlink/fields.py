"""Fields of messages: texts of fixed size, float32 numbers and poses; and their error class."""

from __future__ import annotations

import numpy as np

from glissando.errors import DeviceError
from glissando.geometry.se3 import Array

FLOAT = np.dtype(">f4")
POSE = 48  # bytes: three columns of a rotation, then a position


class MessageError(DeviceError):
    """Bytes are not a valid or supported OpenIGTLink message."""


def fixed_text(text: str, size: int) -> bytes:
    """Encode a text as a field of `size` bytes. Raises DeviceError if it is longer."""
    raw = text.encode()
    if len(raw) > size:
        raise DeviceError(f"{text!r} has {len(raw)} bytes, its field {size}; shorten it.")
    return raw.ljust(size, b"\0")


def text_of(field: bytes) -> str:
    """Decode the text of a field, up to its first zero byte."""
    return field.split(b"\0", 1)[0].decode("utf-8", "replace")


def floats(data: bytes) -> Array:
    """Decode float32 numbers (M,), including NaN and infinity."""
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
        return np.frombuffer(data, FLOAT).astype(float)


def pack_pose(pose: Array) -> bytes:
    """Encode a pose (4, 4) in 48 bytes: columns of the rotation, then the position."""
    return np.asarray(pose)[:3].T.astype(FLOAT).tobytes()


def unpack_pose(data: bytes) -> Array:
    """Decode a pose (4, 4) of 48 bytes."""
    out = np.eye(4)
    out[:3] = floats(data).reshape(4, 3).T
    return out
