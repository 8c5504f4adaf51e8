"""A byte link to a device at a serial path or tcp://host:port."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import time
from collections.abc import Iterator
from typing import Protocol
from urllib.parse import urlsplit

from glissando.errors import DeviceError, needing
from glissando.hardware.drivers.sdk import lost_port

_CONNECT = 5.0  # s allowed for a network device to accept
_FLOOD = 1 << 20  # bytes between two requests, more than any supported device sends
_BREAK = 0.3  # s, duration of a BREAK


class ConnectionLostError(DeviceError):
    """The link to a device is lost: unplugged, switched off, or closed at the other end."""


class DeviceTimeoutError(DeviceError):
    """A device did not answer in time."""


class _Wire(Protocol):
    def receive(self, timeout: float) -> bytes: ...
    def send(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class Link:
    """An open byte link, serial 8N1 without handshake or TCP; a context manager.

    Args:
        address: Serial path, or tcp://host:port.
        baud: Baud rate of a serial line.

    Attributes:
        arrived: Time at which the first bytes after the last write arrived, s of time.monotonic().

    Raises:
        DeviceError: The address cannot be opened.
        ConnectionLostError: The link is lost; from any method.
    """

    def __init__(self, address: str, baud: int = 9600):
        self.address, self.arrived, self._awaits_reply = address, -float("inf"), True
        self._buffer = b""
        network = address.lower().startswith("tcp://")
        self._wire: _Wire = _Tcp(address) if network else _Serial(address, baud)

    def write(self, data: bytes) -> None:
        """Send bytes, after discarding those that were received but not read."""
        self._buffer, dropped = b"", 0
        with self._converted_errors():
            while came := self._wire.receive(0.0):
                dropped += len(came)
                if dropped > _FLOOD:
                    raise ConnectionLostError(
                        f"{self.address} sends without end what nobody asked for; give the address "
                        f"of the device."
                    )
            self._wire.send(data)
        self._awaits_reply = True

    def read(self, count: int, timeout: float) -> bytes:
        """Exactly `count` bytes. Raises DeviceTimeoutError if they do not arrive in `timeout` s."""
        deadline = time.monotonic() + timeout
        while len(self._buffer) < count:
            self._wait(deadline, timeout)
        out, self._buffer = self._buffer[:count], self._buffer[count:]
        return out

    def read_until(self, end: bytes, timeout: float, most: int = 8192) -> bytes:
        """Bytes up to and including `end`, or `most` bytes. Raises DeviceTimeoutError."""
        deadline = time.monotonic() + timeout
        while end not in self._buffer and len(self._buffer) < most:
            self._wait(deadline, timeout)
        at = self._buffer.find(end)
        stop = most if at < 0 else at + len(end)
        out, self._buffer = self._buffer[:stop], self._buffer[stop:]
        return out

    def _wait(self, deadline: float, timeout: float) -> None:
        left = deadline - time.monotonic()
        with self._converted_errors():
            data = self._wire.receive(max(left, 0.0))
        if data and self._awaits_reply:
            self.arrived, self._awaits_reply = time.monotonic(), False
        if not data and left <= 0.0:
            raise DeviceTimeoutError(
                f"{self.address} did not answer within {timeout:.3g} s ({len(self._buffer)} bytes "
                f"came); check that it is switched on and that nothing else uses it."
            )
        self._buffer += data

    def send_break(self) -> bool:
        """Send a BREAK on a serial line, which resets some devices; False if there is none."""
        if not isinstance(self._wire, _Serial) or self._wire.pseudo:
            return False
        self._buffer = b""
        with self._converted_errors():
            self._wire.port.send_break(_BREAK)
        return True

    def set_baud(self, baud: int) -> None:
        """Change the baud rate of a serial line; no effect on a network link."""
        if isinstance(self._wire, _Serial):
            with self._converted_errors():
                self._wire.port.baudrate = baud

    @property
    def baud(self) -> int | None:
        """Baud rate of a serial line; None for a network link."""
        return self._wire.port.baudrate if isinstance(self._wire, _Serial) else None

    def close(self) -> None:
        """Close the link, also a broken one."""
        with contextlib.suppress(OSError):
            self._wire.close()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def _converted_errors(self) -> Iterator[None]:
        try:
            yield
        except lost_port() as problem:
            raise ConnectionLostError(
                f"The link to {self.address} is lost ({problem}); plug the device in again."
            ) from None


class _Tcp:
    def __init__(self, address: str):
        try:
            parts = urlsplit(address)
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if not host or not port:
            raise DeviceError(f"{address} is not a network address; give tcp://host:port.")
        try:
            self.socket = socket.create_connection((host, port), _CONNECT)
        except OSError as problem:
            raise DeviceError(
                f"Nothing answers at {address} ({problem}); check that the device is switched on, "
                f"its address, and that no other program is connected to it."
            ) from None
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def receive(self, timeout: float) -> bytes:
        if not select.select([self.socket], [], [], timeout)[0]:
            return b""
        data = self.socket.recv(4096)
        if not data:
            raise ConnectionResetError("closed at the other end")
        return data

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def close(self) -> None:
        self.socket.close()


class _Serial:
    def __init__(self, path: str, baud: int):
        with needing(f"Opening {path} needs pyserial", "hardware", DeviceError):
            import serial
        try:
            self.port = serial.Serial(path, baud, timeout=0, write_timeout=5.0, exclusive=True)
        except (OSError, ValueError) as problem:
            raise DeviceError(_why_closed(path, problem)) from None
        self.pseudo = os.path.realpath(path).startswith("/dev/pts/")
        with contextlib.suppress(OSError, ValueError, NotImplementedError, AttributeError):
            # USB adapters otherwise collect bytes for up to 16 ms.
            self.port.set_low_latency_mode(True)

    def receive(self, timeout: float) -> bytes:
        if self.port.timeout != timeout:
            self.port.timeout = timeout
        first = self.port.read(1)
        return first + self.port.read(self.port.in_waiting) if first else b""

    def send(self, data: bytes) -> None:
        self.port.write(data)

    def close(self) -> None:
        self.port.close()


def _why_closed(path: str, problem: Exception) -> str:
    code = getattr(problem, "errno", None)
    if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        from serial.tools import list_ports

        ports = ", ".join(sorted(port.device for port in list_ports.comports()))
        existing = f"serial ports here are {ports}" if ports else "there are no serial ports here"
        return f"There is no device {path}: {existing}. Plug it in, or give another address."
    if code in (errno.EACCES, errno.EPERM):
        return (
            f"You may not open {path}. Join the group that may, then log in again: "
            f"sudo usermod -aG dialout $USER"
        )
    if code in (errno.EAGAIN, errno.EBUSY):
        return f"Another program has {path} open; end it first."
    return f"{path} cannot be opened as a serial port ({problem}); give another address."
