"""Commands that set an Aurora up, from a cold start to tracking."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path

from glissando.errors import DeviceError
from glissando.hardware.drivers.aurora_protocol import frame_command, parse_ascii, parse_handles
from glissando.hardware.drivers.aurora_reply import GarbledError, RefusedError
from glissando.hardware.drivers.link import DeviceTimeoutError, Link

BAUD_CODES = {9600: "0", 14400: "1", 19200: "2", 38400: "3", 57600: "4", 115200: "5"}
BAUD_CODES |= {921600: "6", 1228739: "7", 230400: "A"}
"""Baud rates of the device, and their codes in COMM."""

_TRIES = 3  # attempts at a command whose reply arrives damaged
_REPLY = 5.0  # s allowed for a command
_SETTLE = 0.2  # s before and after a change of the baud rate
_REFUSED = 1.0  # s to wait for RESET after a refusal
_ROUNDS = 4  # of initialisation: an initialised coil may reveal another one on the same plug
_SROM, _WRITE = 1024, 64  # bytes of a virtual SROM, and of one write
_NO_SROM = 0x13
_WRONG_MODE = 0x0C


@dataclass(frozen=True)
class Tool:
    """A coil that is plugged in: handle, serial number, and port and channel of its plug."""

    handle: int
    serial: str
    port: str
    channel: str


def ask(link: Link, command: str, timeout: float = _REPLY, tries: int = _TRIES) -> str:
    """Send a command, again if its reply is damaged or missing, and return the reply.

    Args:
        link: Link to the device.
        command: Text without its CRC.
        timeout: Seconds to wait for each reply.
        tries: Maximum number of attempts.

    Raises:
        GarbledError: The last reply was damaged.
        DeviceTimeoutError: The last reply did not arrive.
        RefusedError: The device refused.
    """
    for attempts_left in reversed(range(tries)):
        link.write(frame_command(command))
        try:
            return parse_ascii(link.read_until(b"\r", timeout))
        except (GarbledError, DeviceTimeoutError):
            if not attempts_left:
                raise
    raise AssertionError("at least one try")


def start_up(link: Link, baud: int, patience: float) -> str:
    """Reset and initialise a device, and raise the baud rate of its line.

    Args:
        link: Link to the device.
        baud: Baud rate of a serial line.
        patience: Seconds allowed for each of reset and initialisation.

    Returns:
        The device's version text.

    Raises:
        DeviceError: The device does not answer as an Aurora does.
    """
    _reset(link, patience)
    answer = ask(link, "INIT:", patience)
    if answer != "OKAY":
        raise DeviceError(
            f"{link.address} answered INIT with {answer[:40]!r}, which no Aurora does; give the "
            f"address of an Aurora."
        )
    time.sleep(0.1 if link.baud else 0.0)  # NDI requires a pause after INIT
    if link.baud is not None and baud != link.baud:
        _speed_up(link, baud)
    return ask(link, "VER:0")


def _reset(link: Link, patience: float) -> None:
    """Send a BREAK where the line has one, else RESET; a device without either is left as it is."""
    if link.baud is not None:
        link.set_baud(9600)
    if not link.send_break():
        link.write(b"\r" + frame_command("RESET:"))
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        try:
            reply = link.read_until(b"\r", deadline - time.monotonic())
            if b"RESET" in reply or parse_ascii(reply) == "OKAY":
                return
        except GarbledError:
            continue  # the end of an older message
        except RefusedError:  # of the lone carriage return, or of RESET itself
            deadline = min(deadline, time.monotonic() + _REFUSED)
        except DeviceTimeoutError:
            return  # INIT then shows whether the device responds


def _speed_up(link: Link, baud: int) -> None:
    # A damaged reply may have arrived at either rate; the next command shows which.
    with contextlib.suppress(GarbledError, DeviceTimeoutError):
        ask(link, f"COMM:{BAUD_CODES[baud]}0000", tries=1)
    time.sleep(_SETTLE)
    link.set_baud(baud)
    time.sleep(_SETTLE)


def enable_tools(link: Link, srom: Path | None) -> tuple[list[Tool], list[str]]:
    """Initialise and enable every coil that is plugged in.

    Args:
        link: Link to the device.
        srom: File for coils without a memory of their own.

    Returns:
        The usable coils, and a message on each of the others.

    Raises:
        DeviceError: The device does not answer, or the file cannot be read.
    """
    for handle in parse_handles(ask(link, "PHSR:01")):
        try:
            ask(link, f"PHF:{handle:02X}")
        except RefusedError:
            continue  # freed by an earlier attempt whose reply was damaged
    faulty: dict[int, str] = {}
    for _ in range(_ROUNDS):
        waiting = [h for h in parse_handles(ask(link, "PHSR:02")) if h not in faulty]
        for handle in waiting:
            try:
                _initialise(link, handle, srom)
            except RefusedError as refusal:
                faulty[handle] = _why_faulty(handle, refusal, srom)
        if not waiting:
            break
    for handle in parse_handles(ask(link, "PHSR:03")):
        ask(link, f"PENA:{handle:02X}D")
    enabled = parse_handles(ask(link, "PHSR:04"))
    return [_describe(link, handle) for handle in enabled], list(faulty.values())


def _initialise(link: Link, handle: int, srom: Path | None) -> None:
    """Initialise a coil; one without memory first receives a file or the default configuration."""
    try:
        ask(link, f"PINIT:{handle:02X}")
        return
    except RefusedError as refusal:
        if refusal.code != _NO_SROM:
            raise
    if srom is None:
        ask(link, f"TTCFG:{handle:02X}")
    else:
        image = _read_srom(srom)
        for at in range(0, _SROM, _WRITE):
            ask(link, f"PVWR:{handle:02X}{at:04X}{image[at : at + _WRITE].hex().upper()}")
    ask(link, f"PINIT:{handle:02X}")


def _read_srom(path: Path) -> bytes:
    """Read the image of a virtual SROM, padded to 1024 bytes. Raises DeviceError."""
    try:
        image = path.read_bytes()
    except OSError as problem:
        raise DeviceError(f"SROM file {path} cannot be read ({problem}); give another.") from None
    if not 0 < len(image) <= _SROM:
        raise DeviceError(
            f"SROM file {path} has {len(image)} bytes; give the .rom of a coil, 1 to {_SROM} bytes."
        )
    return image.ljust(_SROM, b"\0")


def _why_faulty(handle: int, refusal: RefusedError, srom: Path | None) -> str:
    if refusal.code not in (_NO_SROM, 0x01):
        return f"Coil {handle:02X} cannot be used. {refusal}"
    tried = "with the default configuration" if srom is None else f"with the SROM file {srom}"
    return (
        f"Coil {handle:02X} does not describe itself (ERROR13: its SROM is absent or damaged), "
        f"and was refused {tried} too; give srom= the .rom file of the coil, or unplug it."
    )


def _describe(link: Link, handle: int) -> Tool:
    """Tool with serial number and plug from PHINF, which are empty if the device refuses."""
    try:
        text = ask(link, f"PHINF:{handle:02X}0021")
    except RefusedError:
        text = ""
    return Tool(handle, text[23:31].strip(), text[43:45], text[45:47])


def begin_tracking(link: Link) -> None:
    """Start tracking, unless the device already tracks. Raises DeviceError."""
    try:
        ask(link, "TSTART:")
    except RefusedError as refusal:
        if refusal.code != _WRONG_MODE:
            raise


def end_tracking(link: Link) -> None:
    """Stop tracking, if the device tracks. Raises DeviceError."""
    try:
        ask(link, "TSTOP:", timeout=1.0)
    except RefusedError as refusal:
        if refusal.code != _WRONG_MODE:
            raise
