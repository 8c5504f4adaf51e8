"""A stage with a GRBL controller, which turns G-code on a serial line into step pulses.

Motions are jogs ($J=) in machine coordinates (G53). A jog cancel (0x85) is a feed hold that drops
all queued jogs and keeps the position. If the host dies, the controller completes at most the few
queued jogs, some hundredths of a second. Based on the documentation of GRBL 1.1 [read: gnea/grbl,
doc/markdown/commands.md, jogging.md and interface.md]; FluidNC and grblHAL use the same protocol.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any, Self

from glissando.errors import DeviceError
from glissando.hardware.drivers.interfaces import SlideReading
from glissando.hardware.drivers.link import DeviceTimeoutError, Link
from glissando.hardware.drivers.position_slide import PositionSlide, StandingError
from glissando.hardware.drivers.position_stage import PositionStage
from glissando.model.table import Table

_STATUS = re.compile(rb"<(\w+)(?::\d+)?\|(MPos|WPos):([-\d.,]+)")
_RESET = b"\x18"
_BANNER = (b"grbl", b"fluidnc")  # beginnings of a controller's greeting after a start
_REPLY, _BOOT = 0.2, 5.0  # s allowed for a reply, and for a restart
_ATTEMPTS = 4
_ERRORS = {
    8: "it is not idle",
    9: "it is locked by an alarm; home it",
    15: "the goal lies outside its own limits ($130…$132)",
    16: "it did not understand a jog; it needs GRBL 1.1 or later",
}
_MM, _MINUTE = 1e3, 60.0
_HOMING = 120.0  # s allowed for a homing cycle
_PATIENCE = 2.0  # s allowed for a motion to stop
_PACE = 0.02  # s between checks whether it has


@dataclass(frozen=True)
class GcodeStage(PositionStage):
    """A stage on one axis of a GRBL controller; `home` is the travel after its homing cycle ($H).

    Attributes:
        axis: Letter of the axis.
        baud: Baud rate of the serial line.

    Raises:
        DeviceError: A value is out of range.
    """

    axis: str = "X"
    baud: int = 115200

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis not in tuple("XYZABC"):
            raise DeviceError(f"There is no axis {self.axis!r}; give X, Y, Z, A, B or C.")

    @classmethod
    def _own(cls, table: Table) -> dict[str, Any]:
        baud = int(table.number("baud", cls.baud))
        return {"axis": table.text("axis", cls.axis), "baud": baud}


def parse_status(line: bytes) -> tuple[str, list[float]]:
    """Parse the state and the position in mm of a status report.

    Raises:
        DeviceError: The line is not a status report, or contains work positions.

    >>> parse_status(b"<Idle|MPos:1.000,0.000,-2.500|FS:0,0>")
    ('Idle', [1.0, 0.0, -2.5])
    """
    match = _STATUS.match(line)
    try:
        if match is None or match[2] != b"MPos":
            raise ValueError
        return match[1].decode(), [float(number) for number in match[3].split(b",")]
    except ValueError:
        raise DeviceError(
            f"The controller answered {line[:60]!r} and no machine position; set $10=1."
        ) from None


class GcodeLine:
    """An open line to a controller, which is restarted when the line is opened.

    Args:
        address: Serial path, or tcp://host:port.
        stage: Settings with the axis and the baud rate.
        counts: Counter of missing and corrupt answers, updated in place.
        on_loss: Called when the controller has lost its position.

    Raises:
        DeviceError: No controller answers; from any method: a refusal or an alarm.
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
        """Restart the controller; if it moves, its position is lost."""
        self._link.write(_RESET)

    def cancel(self) -> None:
        """Cancel the present jog and all queued ones."""
        self._link.write(b"\x85")

    def status(self) -> tuple[str, float]:
        """State of the controller, and machine position of the axis in mm."""
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
        """Send a line and wait for its 'ok' for at most `within` s."""
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
        """Next line that is not empty. Raises DeviceTimeoutError at the end of `timeout` s."""
        end = monotonic() + timeout
        while True:
            if monotonic() > end:
                raise DeviceTimeoutError(f"{self._address} did not answer in time.")
            line = self._link.read_until(b"\n", max(end - monotonic(), 0.0)).strip()
            if line:
                return line


class GcodeSlide(PositionSlide):
    """A stage on a GRBL controller, used as a context manager; at rest after the block.

    Args:
        address: Serial path, or tcp://host:port.
        stage: Limits and axis of the stage.

    Raises:
        DeviceError: From any method: the controller does not answer, refuses or raises an alarm,
            or the travel is not yet known.
    """

    stage: GcodeStage

    def __init__(self, address: str, stage: GcodeStage) -> None:
        super().__init__(stage)
        self.address = address
        self._open: GcodeLine | None = None
        self._homing = False

    def __enter__(self) -> Self:
        self._open = GcodeLine(self.address, self.stage, self.counts, self._forget)
        return self

    def _close(self) -> None:
        self._forget()
        if self._open is not None:
            self._open.close()
            self._open = None

    @property
    def _line(self) -> GcodeLine:
        if self._open is None:
            raise DeviceError("The slide is not open: use it as `with GcodeSlide(…) as slide:`.")
        return self._open

    def home_here(self, travel: float) -> None:
        """Declare the present travel, m, after clearing an alarm for lack of homing."""
        self.stage.require_inside(travel)
        if self._line.status()[0] == "Alarm":
            self._line.send("$X")
        super().home_here(travel)

    def _home_place(self) -> float:
        self._homing = True
        try:
            self._line.send("$H", _HOMING)
        finally:
            self._homing = False
        return self._standing_place()

    def abort(self) -> None:
        """End the motion that another thread waits for; a controller in a homing cycle is reset."""
        super().abort()
        if self._homing:
            self._line.reset()

    def _place(self) -> tuple[float, float]:
        sent = monotonic()
        state, position = self._line.status()
        if state in ("Alarm", "Door", "Sleep"):
            self._forget()
            raise DeviceError(
                f"The controller at {self.address} is in state {state} and its position is not "
                f"sure; clear the cause and home again."
            )
        return 0.5 * (sent + monotonic()), position / _MM

    def _aim(self, place: float, speed: float) -> None:
        feed = max(_MM * _MINUTE * speed, 1.0)
        self._line.send(f"$J=G53G90G21{self.stage.axis}{_MM * place:.4f}F{feed:.1f}")

    def _stands(self, reading: SlideReading) -> bool:
        return self._line.status()[0] == "Idle"

    def stop(self) -> None:
        """Stop at once; the position stays known.

        A controller in a homing cycle ignores a cancel and may not answer. It is reset, as is one
        that does not stop or does not report its state.
        """
        line, end = self._line, monotonic() + _PATIENCE
        while True:
            line.cancel()  # repeatedly: a cancel that arrives between two jogs has no effect
            try:
                state = line.status()[0]
            except StandingError:
                raise
            except DeviceError:
                self._reset()
                raise
            if state not in ("Jog", "Run", "Hold", "Home"):
                return
            if state == "Home" or monotonic() > end:
                self._reset()
                raise DeviceError("The stage did not stop and was reset; home it again.")
            sleep(_PACE)

    def _reset(self) -> None:
        """End any action of the controller, which may lose its position."""
        self._forget()
        self._line.reset()
