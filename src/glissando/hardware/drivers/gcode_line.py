"""The line to a GRBL controller: commands with their answers, alarms, and status reports.

Written after the documentation of GRBL 1.1 [read: gnea/grbl, doc/markdown/commands.md, jogging.md
and interface.md]; FluidNC and grblHAL speak the same.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from time import monotonic

from glissando.errors import DeviceError
from glissando.hardware.drivers.gcode_stage import GcodeStage, parse_status
from glissando.hardware.drivers.link import DeviceTimeoutError, Link
from glissando.hardware.drivers.position_slide import StandingError

_RESET = b"\x18"
_BANNER = (b"grbl", b"fluidnc")  # how a controller greets when it has started
_REPLY, _BOOT = 0.2, 5.0  # s for a reply, a restart
_ATTEMPTS = 4
_ERRORS = {
    8: "it is not idle",
    9: "it is locked by an alarm; home it",
    15: "the goal lies outside its own limits ($130…$132)",
    16: "it did not understand a jog; it needs GRBL 1.1 or later",
}


class GcodeLine:
    """An open line to a controller, which is restarted.

    Args:
        address: Serial path, or tcp://host:port.
        stage: Its axis and the rate of the line.
        counts: Where missing and corrupt answers are counted.
        on_loss: Called when the controller has lost its position.

    Raises:
        DeviceError: No controller answers; from any method: it refuses, or raises an alarm.
    """

    def __init__(
        self, address: str, stage: GcodeStage, counts: Counter[str], on_loss: Callable[[], None]
    ) -> None:
        self._address, self._counts, self._on_loss = address, counts, on_loss
        self._axis = "XYZABC".index(stage.axis)
        self._link = Link(address, stage.baud)
        try:
            self.reset()
            end = monotonic() + _BOOT
            while not self._line(end - monotonic()).lower().startswith(_BANNER):
                pass
        except DeviceTimeoutError:
            self.close()
            raise DeviceError(
                f"No GRBL controller answers at {address} at {stage.baud} baud; check power, "
                f"cable and baud rate."
            ) from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the line."""
        self._link.close()

    def reset(self) -> None:
        """Restart the controller; one that moves loses its position."""
        self._link.write(_RESET)

    def cancel(self) -> None:
        """End a jog and drop those that wait."""
        self._link.write(b"\x85")

    def status(self) -> tuple[str, float]:
        """State, and machine position of the axis in mm."""
        for _ in range(_ATTEMPTS):
            self._link.write(b"?")
            try:
                end = monotonic() + _REPLY
                while not (line := self._line(end - monotonic())).startswith(b"<"):
                    self._require_no_alarm(line)
                state, places = parse_status(line)
                return state, places[self._axis]
            except DeviceTimeoutError:
                self._counts["missing"] += 1
            except StandingError:
                raise
            except (DeviceError, IndexError):
                self._counts["corrupt"] += 1
        raise DeviceError(
            f"The controller at {self._address} did not state its position {_ATTEMPTS} times in a "
            f"row; check the cable, the axis and $10=1."
        )

    def send(self, command: str, within: float = _REPLY) -> None:
        """Send a line and wait for its ok, `within` s."""
        self._link.write(command.encode() + b"\n")
        end = monotonic() + within
        while True:
            try:
                line = self._line(end - monotonic())
            except DeviceTimeoutError:
                raise DeviceError(
                    f"The controller at {self._address} did not answer {command!r} within "
                    f"{within:g} s; check the cable."
                ) from None
            if line == b"ok":
                return
            if refusal := re.fullmatch(rb"error:(\d+)", line):
                why = _ERRORS.get(int(refusal[1]), f"error {int(refusal[1])} of GRBL's list")
                raise DeviceError(f"The controller refused {command!r}: {why}.")
            self._require_no_alarm(line)

    def _require_no_alarm(self, line: bytes) -> None:
        if line.lower().startswith(_BANNER):
            self._on_loss()
            raise StandingError(
                f"The controller at {self._address} has restarted and lost its position; check its "
                f"supply and home again."
            )
        if line.startswith(b"ALARM"):
            self._on_loss()
            raise StandingError(
                f"The controller at {self._address} raised {line.decode('ascii', 'replace')}; "
                f"clear the cause and home again."
            )

    def _line(self, timeout: float) -> bytes:
        """The next line that is not empty. Raises DeviceTimeoutError, whatever comes later."""
        end = monotonic() + timeout
        while True:
            if monotonic() > end:
                raise DeviceTimeoutError(f"{self._address} did not answer in time.")
            line = self._link.read_until(b"\n", max(end - monotonic(), 0.0)).strip()
            if line:
                return line
