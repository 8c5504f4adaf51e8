"""Assignment of the tracker's tools to the coils of a rig."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from glissando.errors import DeviceError
from glissando.hardware.capture.setup import Coil
from glissando.hardware.drivers.aurora_setup import Tool


def name_by_handle(tools: Sequence[Tool], coils: tuple[Coil, ...]) -> dict[int, str]:
    """Names of the coils by handle: first by serial number, then in the order of the tools.

    Args:
        tools: Coils that are plugged in.
        coils: Coils of the setup file.

    Raises:
        DeviceError: A coil of the setup has no tool.
    """
    handles = {tool.serial: tool.handle for tool in tools}
    free = [tool.handle for tool in tools]
    names = {}
    for coil in sorted(coils, key=lambda coil: not coil.serial):
        if coil.serial and coil.serial not in handles:
            raise DeviceError(
                f"No coil with serial number {coil.serial!r} ({coil.name}) is plugged in, only "
                f"{', '.join(handles)}; plug it in, or correct `serial`."
            )
        handle = handles[coil.serial] if coil.serial else next(iter(free), None)
        if handle not in free:
            raise DeviceError(
                f"{len(tools)} coils are plugged in and the setup names {len(coils)}; plug "
                f"{coil.name} in, or leave it out."
            )
        free.remove(handle)
        names[handle] = coil.name
    return names


def name_by_identity(tools: Sequence[Tool], names: dict[int, str]) -> dict[str, str]:
    """Names of the coils by serial number, where it is unique, and by position on the plugs.

    A coil that is plugged in again may have another handle, or not report its serial number.

    Args:
        tools: Coils that are plugged in.
        names: Names by handle.

    Raises:
        DeviceError: Two coils cannot be distinguished.
    """
    named = [tool for tool in tools if tool.handle in names]
    serials, plugs = Counter(tool.serial for tool in tools), Counter(map(plug, tools))
    unique = {t.serial: names[t.handle] for t in named if t.serial and serials[t.serial] == 1}
    for tool in named:
        if tool.serial not in unique and plugs[plug(tool)] > 1:
            raise DeviceError(
                f"Coil {names[tool.handle]} states {plug(tool)} and so does another, and no serial "
                f"number tells them apart; unplug one of them."
            )
    return {plug(t): names[t.handle] for t in named if plugs[plug(t)] == 1} | unique


def plug(tool: Tool) -> str:
    """Port and channel of a tool; its handle if it does not report them."""
    if not tool.port and not tool.channel:
        return f"handle {tool.handle:02X}"
    return f"port {tool.port}, channel {tool.channel}"
