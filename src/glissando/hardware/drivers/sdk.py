"""Port of the official Dynamixel SDK, with readable errors and without busy waiting."""

from __future__ import annotations

import os
from typing import Any

from glissando.errors import DeviceError, needing


def lost_port() -> tuple[type[Exception], ...]:
    """Exceptions that pyserial raises when its port disappears."""
    try:
        import termios
    except ImportError:  # Windows
        return (OSError,)
    return OSError, termios.error


def opened(address: str, baud: int) -> tuple[Any, Any]:
    """Open the SDK's port; returns port and packet handler. Raises DeviceError."""
    with needing("The slide needs dynamixel-sdk", "hardware", DeviceError):
        from dynamixel_sdk import PacketHandler, PortHandler
    port = PortHandler(address)
    try:
        ready = port.setBaudRate(baud)
        if ready and os.name == "posix":  # Windows opens a port for one program only
            port.ser.exclusive = True  # another program would switch the torque off
    except lost_port() as problem:
        raise DeviceError(
            f"The port {address} cannot be opened ({problem}); check its name, your rights to it, "
            f"and that no other program has it."
        ) from None
    if not ready:
        raise DeviceError(f"The SDK knows no rate of {baud} baud; give 57600 or 1000000, say.")
    port.ser.timeout = 0.002  # block until bytes arrive instead of polling continuously
    return port, PacketHandler(2.0)
