"""Live motion capture by the UDP object stream of Vicon Tracker.

A datagram, little-endian: frame number u32, count of items u8; an item: kind u8 (0 an object), size
u16 (72), name of 24 bytes padded with NUL, translation in mm and Euler angles XYZ in rad, six
float64. Several independent public parsers agree on this layout. [inferred], to be verified on
hardware: angles are intrinsic, R = Rx Ry Rz; an object that is not visible has six zeros or is
absent; bytes after the last item are padding; a frame that does not fit one datagram arrives in
several with the same number.
"""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from glissando.errors import DeviceError
from glissando.geometry import se3
from glissando.geometry.se3 import Array

PORT = 51001
_FRAME, _ITEM, _OBJECT = struct.Struct("<IB"), struct.Struct("<BH"), struct.Struct("<24s6d")
_OBJECT_KIND = 0
_FARTHEST_MM = 1e6  # a kilometre, larger than any volume: such bytes are not a pose
_BACK, _AHEAD = 100, 10_000  # frames: a larger jump shows that Tracker was restarted
_BUFFER = 1 << 20  # bytes that the system buffers while the reader is busy


@dataclass(frozen=True)
class ViconFrame:
    """Objects of one datagram.

    Attributes:
        number: The frame's number.
        received: Time of arrival, monotonic s; later than exposure by Tracker's latency.
        poses: T_wo (4, 4) in metres, by name of the object.
        missing: Names of objects that were not visible.
        problems: Number of 'truncated' bytes, 'unknown' items and 'malformed' objects.
    """

    number: int
    received: float
    poses: dict[str, Array]
    missing: tuple[str, ...] = ()
    problems: Counter[str] = field(default_factory=Counter)


def parse_packet(data: bytes, received: float) -> ViconFrame | None:
    """Parse a datagram; None if it is shorter than a header.

    Args:
        data: The datagram.
        received: Time of arrival, monotonic s.
    """
    if len(data) < _FRAME.size:
        return None
    number, count = _FRAME.unpack_from(data)
    poses: dict[str, Array] = {}
    missing: list[str] = []
    problems: Counter[str] = Counter()
    at = _FRAME.size
    for _ in range(count):
        if at + _ITEM.size > len(data):
            problems["truncated"] += 1
            break
        kind, size = _ITEM.unpack_from(data, at)
        item = data[at + _ITEM.size : at + _ITEM.size + size]
        at += _ITEM.size + size
        if len(item) < size:
            problems["truncated"] += 1
            break
        if kind != _OBJECT_KIND:
            problems["unknown"] += 1
            continue
        name, values = _object(item)
        if not name or name in poses or name in missing:
            problems["malformed"] += 1
        elif not values.any():
            missing.append(name)
        else:
            turn = Rotation.from_euler("XYZ", values[3:]).as_matrix()
            poses[name] = se3.pose(turn, 1e-3 * values[:3])
    return ViconFrame(number, received, poses, tuple(missing), problems)


def _object(item: bytes) -> tuple[str, Array]:
    """Name and six numbers of an object; an empty name if the bytes are not an object."""
    if len(item) != _OBJECT.size:
        return "", np.zeros(6)
    label, *numbers = _OBJECT.unpack(item)
    values = np.array(numbers)
    if not np.all(np.isfinite(values)) or np.abs(values).max() > _FARTHEST_MM:
        return "", values
    return label.split(b"\0", 1)[0].decode("utf-8", "replace").strip(), values


class ViconStream:
    """Frames received on a UDP port; a context manager and an iterator.

    Args:
        port: UDP port; 0 takes any free one.
        host: Address of this computer to listen on; 0.0.0.0 for all networks.
        timeout: Seconds without a useful datagram after which `read` raises.

    Attributes:
        counts: Problems by name: datagrams 'malformed', items 'truncated', 'unknown' or
            'malformed', frames 'lost', 'out of order' or 'repeated' (both dropped), and 'restarted'
            for a jump of the frame number.

    Raises:
        DeviceError: The port is in use; from `read`, no valid frame arrived.
    """

    def __init__(self, port: int = PORT, *, host: str = "127.0.0.1", timeout: float = 2.0) -> None:
        self.port, self.host, self.timeout = port, host, timeout
        self.counts: Counter[str] = Counter()
        self._socket: socket.socket | None = None
        self._last: int | None = None
        self._seen: set[str] = set()  # objects of the last frame

    def __enter__(self) -> Self:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            opened.bind((self.host, self.port))
        except (OSError, OverflowError) as problem:
            opened.close()
            why = getattr(problem, "strerror", None) or problem
            raise DeviceError(
                f"UDP port {self.port} cannot be listened to ({why}); close the other program that "
                f"does, or choose another port here and in Tracker."
            ) from None
        self.port = opened.getsockname()[1]
        self._socket = opened
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket:
            self._socket.close()
        self._socket = None

    def __iter__(self) -> Iterator[ViconFrame]:
        while True:
            yield self.read()

    def read(self) -> ViconFrame:
        """Wait for the next frame that is newer. Raises DeviceError after `timeout` s."""
        deadline = time.monotonic() + self.timeout
        refused = 0
        while (data := self._receive(deadline)) is not None:
            frame = parse_packet(data, time.monotonic())
            self.counts += frame.problems if frame else Counter(malformed=1)
            if frame is None or (frame.problems and not frame.poses and not frame.missing):
                refused += 1
            elif self._in_order(frame):
                return frame
            if time.monotonic() > deadline:
                break
        raise DeviceError(self._silence(refused))

    def _receive(self, deadline: float) -> bytes | None:
        """Next datagram; None after the deadline."""
        if self._socket is None:
            raise DeviceError("The Vicon stream is closed; use it inside `with ViconStream(port)`.")
        self._socket.settimeout(max(deadline - time.monotonic(), 0.0))
        try:
            return self._socket.recv(65536)
        except (TimeoutError, BlockingIOError):
            return None

    def _in_order(self, frame: ViconFrame) -> bool:
        """Whether the frame is new; counts lost frames by the gap in the numbers."""
        names = {*frame.poses, *frame.missing}
        if self._last is None:
            ahead = 1
        else:
            ahead = (frame.number - self._last + (1 << 31)) % (1 << 32) - (1 << 31)
        if not -_BACK < ahead < _AHEAD:
            self.counts["restarted"] += 1
            ahead = 1
        if ahead < 0:
            self.counts["out of order"] += 1
            return False
        if ahead == 0 and (names <= self._seen):
            self.counts["repeated"] += 1
            return False
        if ahead > 1:
            self.counts["lost"] += ahead - 1
        self._last = frame.number
        self._seen = names if ahead else self._seen | names
        return True

    def _silence(self, refused: int) -> str:
        what = f"{refused} datagrams came, but no Vicon objects" if refused else "Nothing came"
        return (
            f"{what} on UDP port {self.port} of {self.host} for {self.timeout:g} s; check in "
            f"Tracker that the UDP object stream is on and names this computer's address and port "
            f"{self.port}, that an object is switched on, and that no firewall is between; "
            f"127.0.0.1 hears this computer alone, 0.0.0.0 every one."
        )
