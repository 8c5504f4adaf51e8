"""Registers of a servo through the official SDK, with retries, error counts and time stamps.

The SDK mistakes a late answer to one request for the answer to the next; this module detects it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from glissando.errors import DeviceError
from glissando.hardware.drivers.sdk import lost_port, opened

WRAP = 32768  # ms, at which the servo's clock wraps
DRIVE_MODE, OPERATING_MODE, HOMING_OFFSET = 10, 11, 20
TORQUE, HARDWARE_ERROR, WATCHDOG = 64, 70, 98
PWM_LIMIT, GOAL_PWM, PROFILE, TICK = 36, 100, 108, 120

XL430 = 1060  # model number
_EXTENDED_POSITION = 4  # operating mode
_TORQUE_TOLERANCE = 150  # ticks by which the position may change when torque is switched on
_ATTEMPTS = 4
_QUIET = 0.03  # s without a byte after which no late answer is expected
_NO_REPLY, _CORRUPT, _RESEND = -3001, -3002, 3
_ALERT = 0x80
_REFUSED = {
    1: "it could not do it",
    2: "it does not know the instruction",
    4: "a value is out of range",
    5: "a value has the wrong length",
    6: "a value is beyond a limit set in its registers",
    7: "the register cannot be written now",
}
_HARDWARE = {
    0x01: "its supply voltage is outside its limits; check the power supply",
    0x04: "it is too hot; let it cool",
    0x08: "its encoder has failed; replace it",
    0x10: "its electronics had a shock or too little power; check the power supply",
    0x20: "it was overloaded; free the carriage",
}


class NoAnswerError(DeviceError):
    """A servo did not answer several successive requests."""


@dataclass(frozen=True)
class Answer:
    """Bytes that a servo sent, and the host's monotonic times in s before and after."""

    data: bytes
    sent: float
    answered: float

    def signed(self, offset: int, size: int) -> int:
        """Signed integer of `size` bytes at an offset."""
        return int.from_bytes(self.data[offset : offset + size], "little", signed=True)


@dataclass(frozen=True)
class State:
    """One reading of a servo's state, in the servo's units.

    Attributes:
        time: Midpoint of the exchange, monotonic s of the host.
        clock: Time of the servo's clock, unwrapped, s.
        load: Load, in units of 0.1 %.
        velocity: Speed, in units of 0.229 rpm.
        position: Position, ticks.
    """

    time: float
    clock: float
    load: int
    velocity: int
    position: int


def hardware_error(bits: int) -> str:
    """Describe the hardware-error status (register 70).

    >>> hardware_error(0x24)
    'it is too hot; let it cool, and it was overloaded; free the carriage'
    """
    errors = [words for bit, words in _HARDWARE.items() if bits & bit]
    return ", and ".join(errors) or f"it reports the unknown error {bits:#04x}"


def unwrapped(last: int, tick: int, elapsed: float) -> int:
    """Unwrap a tick of 0…32767 ms.

    Args:
        last: An earlier tick, unwrapped.
        tick: The present tick.
        elapsed: Seconds between them, with an error below 16 s.

    >>> unwrapped(32_700, 40, elapsed=0.1), unwrapped(32_700, 40, elapsed=33.0)
    (32808, 65576)
    """
    expected = last + round(1e3 * elapsed)
    return expected + (tick - expected + WRAP // 2) % WRAP - WRAP // 2


class Servo:
    """The registers of one servo; methods raise DeviceError if it fails or does not answer.

    Attributes:
        counts: Number of answers that were 'missing', 'corrupt', 'stale', 'refused' or 'failed'.
        aborted: Set by another thread to end a motion: `state` then raises DeviceError.

    Args:
        address: Serial path.
        identity: ID of the servo on its bus.
        baud: Baud rate of the serial line.
    """

    def __init__(self, address: str, identity: int, baud: int) -> None:
        self.address, self.identity, self.baud = address, identity, baud
        self.counts: Counter[str] = Counter()
        self.aborted = False
        self._port, self._handler = opened(address, baud)
        self._clock: tuple[int, Answer] | None = None  # unwrapped ms of the last state, and it

    def close(self) -> None:
        """Close the port."""
        try:
            self._port.closePort()
        except OSError:  # it is gone already
            self._port.is_open = False

    def read(self, address: int, size: int, *, check_error: bool = True) -> Answer:
        """Read registers.

        Args:
            address: Address of the first byte.
            size: Number of bytes.
            check_error: Whether a pending hardware error raises DeviceError.
        """

        def ask() -> tuple[list[int], int, int]:
            data, result, error = self._handler.readTxRx(self._port, self.identity, address, size)
            short = result == 0 and not error & ~_ALERT and len(data) != size
            return data, _CORRUPT if short else result, error

        return self._request(f"read {size} bytes at {address}", ask, check_error=check_error)

    def write(self, address: int, *values: tuple[int, int], check_error: bool = True) -> None:
        """Write registers.

        Args:
            address: Address of the first byte.
            values: Each (number, size in bytes), in consecutive registers.
            check_error: Whether a pending hardware error raises DeviceError.
        """
        data = b"".join((n % (1 << 8 * size)).to_bytes(size, "little") for n, size in values)

        def ask() -> tuple[list[int], int, int]:
            send = self._handler.writeTxRx
            return [], *send(self._port, self.identity, address, len(data), list(data))

        shown = ", ".join(str(number) for number, _ in values)
        self._request(f"write {shown} at {address}", ask, check_error=check_error)

    def reboot(self) -> None:
        """Restart the servo, which clears hardware errors and loses the count of turns."""
        self._request(
            "reboot",
            lambda: ([], *self._handler.reboot(self._port, self.identity)),
            check_error=False,
        )
        self._clock = None

    def prepare(self) -> None:
        """Initialise the registers. Those of the EEPROM are written only where they differ."""

        def ping() -> tuple[list[int], int, int]:
            model, result, error = self._handler.ping(self._port, self.identity)
            return [model & 0xFF, model >> 8], result, error

        model = self._request("ping it", ping).signed(0, 2)
        if model != XL430:
            raise DeviceError(
                f"The servo {self.identity} at {self.address} is of model {model}; the slide knows "
                f"the XL430-W250, {XL430}."
            )
        for address in (TORQUE, WATCHDOG):
            self.write(address, (0, 1), check_error=False)
        # Drive mode 0: not reversed, velocity-based profiles, no torque on a goal alone. With a
        # homing offset some firmware runs away when its watchdog trips (DynamixelSDK, 2022).
        wanted = (
            (OPERATING_MODE, _EXTENDED_POSITION, 1),
            (DRIVE_MODE, 0, 1),
            (HOMING_OFFSET, 0, 4),
        )
        for address, value, size in wanted:
            if self.read(address, size, check_error=False).signed(0, size) != value:
                self.write(address, (value, size), check_error=False)

    def state(self, *, check_error: bool = True) -> State:
        """Read clock, load, velocity and position in one request.

        An answer whose tick lies outside the exchange belongs to an earlier request, and the
        request is repeated; if that does not help, the servo has restarted: DeviceError is raised.
        """
        if check_error and self.aborted:
            raise DeviceError("The motion of the stage was aborted.")
        for _ in range(_ATTEMPTS):
            answer = self.read(TICK, 16, check_error=check_error)
            tick = int.from_bytes(answer.data[:2], "little")
            if (now := self._unwrapped_tick(tick, answer)) is not None:
                self._clock = now, answer
                middle = 0.5 * (answer.sent + answer.answered)
                load, velocity, position = (answer.signed(*at) for at in ((6, 2), (8, 4), (12, 4)))
                return State(middle, 1e-3 * now, load, velocity, position)
            self.counts["stale"] += 1
            self._drain()
        raise DeviceError(
            f"The clock of the servo at {self.address} jumped: it lost power for a moment, and "
            f"its position with it. Check the supply, then home again."
        )

    def aim(
        self, goal: int, *, speed: int, acceleration: int = 0, check_error: bool = True
    ) -> None:
        """Send a goal with its limits in one packet, in the servo's units.

        Args:
            goal: Position, ticks.
            speed: Largest speed; 0 for no limit.
            acceleration: Acceleration; 0 for steps in speed.
            check_error: Whether a pending hardware error raises DeviceError.
        """
        self.write(PROFILE, (acceleration, 4), (speed, 4), (goal, 4), check_error=check_error)

    def power(self) -> None:
        """Switch the torque on, and check the position: some firmware then miscounts turns."""
        self._clock = None  # homing follows
        before = self.state().position
        self.aim(before, speed=0)
        self.write(TORQUE, (1, 1))
        moved = self.state().position - before
        if abs(moved) > _TORQUE_TOLERANCE:
            raise DeviceError(
                f"The servo at {self.address} moved or miscounted by {moved} ticks when its torque "
                f"came on; look at the carriage and home again."
            )

    def watchdog_stopped(self) -> bool:
        """Whether the watchdog has stopped the servo; False also if it does not answer."""
        try:
            return self.read(WATCHDOG, 1, check_error=False).signed(0, 1) < 0
        except DeviceError:
            return False

    def halt(self) -> bool:
        """Hold the position, or if that fails switch the torque off; returns whether it holds."""
        try:
            self.aim(self.state(check_error=False).position, speed=0, check_error=False)
            holds = True
        except NoAnswerError:
            holds = False
        except DeviceError:
            holds = self.watchdog_stopped()  # then it refuses goals, and is already at rest
        if not holds:
            self.write(TORQUE, (0, 1), check_error=False)
        self.write(WATCHDOG, (0, 1), check_error=False)  # only once it is at rest
        return holds

    def _unwrapped_tick(self, tick: int, answer: Answer) -> int | None:
        """Unwrapped tick; None if it was not taken between request and answer."""
        if self._clock is None:
            return tick
        last, before = self._clock
        elapsed = 0.5 * (answer.sent + answer.answered - before.sent - before.answered)
        now = unwrapped(last, tick, elapsed)
        slack = 0.003 + 0.02 * elapsed  # s: one tick either way, and the error of the servo's clock
        least, most = answer.sent - before.answered, answer.answered - before.sent
        return now if least - slack <= 1e-3 * (now - last) <= most + slack else None

    def _request(
        self, what: str, ask: Callable[[], tuple[list[int], int, int]], *, check_error: bool = True
    ) -> Answer:
        """Repeat a request until an intact answer arrives, a few times at most."""
        for _ in range(_ATTEMPTS):
            self._port.is_using = False  # an exception inside the SDK leaves it set
            sent = monotonic()
            try:
                data, result, error = ask()
            except lost_port() as problem:
                raise DeviceError(
                    f"The port {self.address} is gone ({problem}); plug the adapter in again."
                ) from None
            answered = monotonic()
            if result == 0 and error & ~_ALERT != _RESEND:
                self._require_sound(what, error, check_error=check_error)
                return Answer(bytes(data), sent, answered)
            kinds = {_NO_REPLY: "missing", _CORRUPT: "corrupt"}
            self.counts["refused" if result == 0 else kinds.get(result, "failed")] += 1
            self._drain()
        raise NoAnswerError(
            f"The servo {self.identity} at {self.address} did not answer {_ATTEMPTS} times in a "
            f"row at {self.baud} baud (could not {what}); check its power, cable, baud rate and id."
        )

    def _require_sound(self, what: str, error: int, *, check_error: bool) -> None:
        if error & _ALERT and check_error:
            bits = self.read(HARDWARE_ERROR, 1, check_error=False).data[0]
            raise DeviceError(
                f"The servo at {self.address} has switched off: {hardware_error(bits)}. Then "
                f"reboot() it and home again."
            )
        if error & ~_ALERT:
            why = _REFUSED.get(error & ~_ALERT, f"error {error}")
            raise DeviceError(f"The servo at {self.address} would not {what}: {why}.")

    def _drain(self) -> None:
        """Wait until the line is quiet, so that a late answer is not taken for the next one."""
        quiet_since = begun = monotonic()
        while monotonic() < min(quiet_since + _QUIET, begun + 4.0 * _QUIET):
            try:
                if self._port.readPort(1024):
                    quiet_since = monotonic()
            except lost_port():
                return
