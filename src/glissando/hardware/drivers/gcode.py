"""A stage that a GRBL controller drives: steps and direction by G-code over a serial line.

Motions are jogs ($J=) in machine coordinates (G53). A jog cancel (0x85) is a feed hold that drops
all further jogs and keeps the position; a host that dies leaves at most the few that are on their
way, some hundredths of a second. Written after the documentation of GRBL 1.1 [read: gnea/grbl,
doc/markdown/commands.md, jogging.md and interface.md]; FluidNC and grblHAL speak the same.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from time import monotonic, sleep
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import DeviceError
from glissando.hardware.drivers.gcode_stage import GcodeStage, parse_status
from glissando.hardware.drivers.interfaces import SlideReading
from glissando.hardware.drivers.link import Link, SilentError

_MM = 1e3
_MINUTE = 60.0
_CANCEL, _RESET = b"\x85", b"\x18"
_BANNER = (b"grbl", b"fluidnc")  # how a controller greets when it has started
_REPLY, _HOMING, _BOOT = 0.2, 120.0, 5.0  # s for a reply, a homing cycle, a restart
_ATTEMPTS = 4
_AHEAD = 3  # periods that a streamed goal is ahead of the path's now
_NEAR = 5e-4  # m from its goal where a move has arrived
_PACE = 0.02  # s between the readings of a move
_PATIENCE = 2.0  # s after a move should have ended
_STEP = 2e-6  # m: shorter jogs are not sent
_ERRORS = {
    8: "it is not idle",
    9: "it is locked by an alarm; home it",
    15: "the goal lies outside its own limits ($130…$132)",
    16: "it did not understand a jog; it needs GRBL 1.1 or later",
}


class GcodeSlide:
    """A stage on a GRBL controller, to be used in a with-block; it stands still afterwards.

    Args:
        address: Serial path, or tcp://host:port.
        stage: Its limits and its axis.

    Attributes:
        counts: How many answers were missing or corrupt.

    Raises:
        DeviceError: From any method: the controller does not answer, refuses, raises an alarm, or
            the travel is not known yet.
    """

    def __init__(self, address: str, stage: GcodeStage) -> None:
        self.address, self.stage = address, stage
        self.counts: Counter[str] = Counter()
        self._link: Link | None = None
        self._zero: float | None = None  # machine position at travel zero, mm
        self._last: SlideReading | None = None

    def __enter__(self) -> Self:
        self._link = Link(self.address, self.stage.baud)
        try:
            self._link.write(_RESET)
            end = monotonic() + _BOOT
            while not self._line(end - monotonic()).lower().startswith(_BANNER):
                pass
        except SilentError:
            self._close()
            raise DeviceError(
                f"No GRBL controller answers at {self.address} at {self.stage.baud} baud; check "
                f"power, cable and baud rate."
            ) from None
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        try:
            self.stop()
        except DeviceError:
            if problem is None:
                raise
        finally:
            self._close()

    def _close(self) -> None:
        self._zero = None
        if self._link is not None:
            self._link.close()
            self._link = None

    def home_here(self, travel: float) -> None:
        """Declare the stage's travel now, in metres; an alarm of a missing homing is unlocked."""
        self.stage.require_inside(travel)
        state, position = self._status()
        if state == "Alarm":
            self._send("$X")
            state, position = self._status()
        self._zero, self._last = position - _MM * self.stage.direction * travel, None

    def home_at_stop(self) -> None:
        """Run the controller's homing cycle, then enter the stroke."""
        if self.stage.home is None:
            raise DeviceError(
                "The stage has no homing switch; give its travel there as `home`, or say where it "
                "is with home_here(travel)."
            )
        self._send("$H", _HOMING)
        _, position = self._status()
        self._zero = position - _MM * self.stage.direction * self.stage.home
        self._last = None
        self.move(float(np.clip(self.stage.home, *self.stage.stroke)))

    def read(self) -> SlideReading:
        """Where the stage is now; its speed is that since the reading before.

        The line has no checksum: a position that the stage cannot have reached is asked for again.
        """
        for _ in range(_ATTEMPTS):
            reading = self._read()
            if self._last is None or self._reachable(self._last, reading):
                self._last = reading
                return reading
            self.counts["corrupt"] += 1
        self._zero = None
        raise DeviceError(
            f"The stage is at {_MM * reading.travel:.4g} mm, where it cannot have gone since the "
            f"last reading; somebody else moves it, or the line is disturbed. Home again."
        )

    def _read(self) -> SlideReading:
        zero = self._require_home()
        asked = monotonic()
        state, position = self._status()
        time = 0.5 * (asked + monotonic())
        if state in ("Alarm", "Door", "Sleep"):
            self._zero = None
            raise DeviceError(
                f"The controller at {self.address} is in state {state} and its position is not "
                f"sure; clear the cause and home again."
            )
        travel = self.stage.direction * (position - zero) / _MM
        last, speed = self._last, 0.0
        if last is not None and 0.0 < time - last.time < 1.0:
            speed = (travel - last.travel) / (time - last.time)
        return SlideReading(time, time, travel, speed, 0.0)

    def _reachable(self, last: SlideReading, now: SlideReading) -> bool:
        way = abs(now.travel - last.travel)
        return way <= 1.5 * self.stage.speed * (now.time - last.time) + _NEAR

    def move(self, travel: float, *, speed: float | None = None) -> list[SlideReading]:
        """Go to a travel in metres at a speed in m/s, the stage's by default."""
        speed = self.stage.speed if speed is None else speed
        self.stage.require_inside(travel)
        self.stage.require_allowed(speed)
        start = self.read()
        lasts = abs(travel - start.travel) / speed + speed / self.stage.acceleration
        with _standing_still(self):
            self._jog(travel, speed, start.travel)
            return [start, *self._until_rest(travel, lasts)]

    def follow(
        self, time: ArrayLike, travel: ArrayLike, *, rate: float = 20.0
    ) -> Iterator[SlideReading]:
        """Follow a path, straight between its points, yielding readings.

        Args:
            time: Times (K,), s; the first is now.
            travel: Travels (K,) at these times, m.
            rate: Goals and readings a second.
        """
        times, places = self.stage.path(time, travel)
        self.move(float(places[0]))
        yield from self.pursue(lambda t: np.interp(t, times, places), times[-1], rate=rate)

    def pursue(
        self, wanted: Callable[[float], float], lasts: float, *, rate: float = 20.0
    ) -> Iterator[SlideReading]:
        """Follow a path that is decided on the way, yielding readings; at its end, rest.

        Args:
            wanted: The travel in m at a time in s from now, up to three periods after the end.
            lasts: Duration, s.
            rate: Goals and readings a second.
        """
        with _standing_still(self):
            aim = self.read().travel
            begun = beat = until = monotonic()  # until: when the queued jogs end
            while (now := monotonic()) - begun < lasts:
                goal = float(wanted(now - begun + _AHEAD / rate))
                self.stage.require_inside(goal)
                span = now + _AHEAD / rate - max(until, now)
                speed = min(abs(goal - aim) / span, 1.1 * self.stage.speed)
                aim, until = self._jog(goal, speed, aim), now + _AHEAD / rate
                reading = self.read()
                self._require_near(reading, float(wanted(reading.time - begun)))
                yield reading
                beat = max(beat + 1.0 / rate, now)
                sleep(max(beat - monotonic(), 0.0))
            last = float(wanted(lasts))
            self._jog(last, self.stage.speed, aim)
            yield from self._until_rest(last, 0.5)

    def stop(self) -> None:
        """Stand still at once; the position stays known."""
        link = self._open()
        end = monotonic() + _PATIENCE
        while True:
            link.write(_CANCEL)  # again and again: one that comes between two jogs has no effect
            if self._status()[0] not in ("Jog", "Run", "Hold"):
                return
            if monotonic() > end:
                link.write(_RESET)
                self._zero = None
                raise DeviceError("The stage did not stop and was reset; home it again.")
            sleep(_PACE)

    def _jog(self, travel: float, speed: float, since: float) -> float:
        """Queue a jog to a travel, unless it is next to nothing; where the queue now ends, m."""
        if abs(travel - since) < _STEP:
            return since
        zero, feed = self._require_home(), max(_MM * _MINUTE * speed, 1.0)
        place = zero + _MM * self.stage.direction * travel
        self._send(f"$J=G53G90G21{self.stage.axis}{place:.4f}F{feed:.1f}")
        return travel

    def _until_rest(self, goal: float, lasts: float) -> Iterator[SlideReading]:
        begun = monotonic()
        while True:
            reading = self.read()
            yield reading
            if abs(reading.travel - goal) < _NEAR and self._status()[0] == "Idle":
                return
            if monotonic() - begun > lasts + _PATIENCE:
                raise DeviceError(
                    f"The stage is at {_MM * reading.travel:.4g} mm instead of {_MM * goal:.4g} "
                    f"mm; free it, check steps per mm ($100), and home again."
                )
            sleep(_PACE)

    def _require_near(self, reading: SlideReading, wanted: float) -> None:
        behind = abs(reading.travel - wanted)
        if behind > self.stage.lag:
            raise DeviceError(
                f"The stage is {_MM * behind:.2g} mm off its path at {_MM * wanted:.3g} mm and "
                f"was stopped; slow the path down, raise the controller's acceleration, or `lag`."
            )

    def _require_home(self) -> float:
        if self._zero is None:
            raise DeviceError(
                "The stage does not know where it is. Home it first with home_here(travel) or "
                "home_at_stop()."
            )
        return self._zero

    def _status(self) -> tuple[str, float]:
        """State and machine position of the axis, mm."""
        for _ in range(_ATTEMPTS):
            self._open().write(b"?")
            try:
                end = monotonic() + _REPLY
                while not (line := self._line(end - monotonic())).startswith(b"<"):
                    self._require_no_alarm(line)
                state, places = parse_status(line)
                return state, places["XYZABC".index(self.stage.axis)]
            except SilentError:
                self.counts["missing"] += 1
            except _AlarmError:
                raise
            except (DeviceError, IndexError):
                self.counts["corrupt"] += 1
        raise DeviceError(
            f"The controller at {self.address} did not state its position {_ATTEMPTS} times in a "
            f"row; check the cable, the axis and $10=1."
        )

    def _send(self, command: str, within: float = _REPLY) -> None:
        """Send a line and wait for its ok."""
        self._open().write(command.encode() + b"\n")
        end = monotonic() + within
        while True:
            try:
                line = self._line(end - monotonic())
            except SilentError:
                raise DeviceError(
                    f"The controller at {self.address} did not answer {command!r} within "
                    f"{within:g} s; check the cable."
                ) from None
            if line == b"ok":
                return
            if found := re.fullmatch(rb"error:(\d+)", line):
                why = _ERRORS.get(int(found[1]), f"error {int(found[1])} of GRBL's list")
                raise DeviceError(f"The controller refused {command!r}: {why}.")
            self._require_no_alarm(line)

    def _require_no_alarm(self, line: bytes) -> None:
        if line.lower().startswith(_BANNER):
            self._zero = None
            raise _AlarmError(
                f"The controller at {self.address} has restarted and lost its position; check its "
                f"supply and home again."
            )
        if line.startswith(b"ALARM"):
            self._zero = None
            raise _AlarmError(
                f"The controller at {self.address} raised {line.decode('ascii', 'replace')}; clear "
                f"the cause and home again."
            )

    def _line(self, timeout: float) -> bytes:
        """The next line that is not empty. Raises SilentError, however much comes after that."""
        end = monotonic() + timeout
        while True:
            if monotonic() > end:
                raise SilentError(f"{self.address} did not answer in time.")
            line = self._open().read_until(b"\n", max(end - monotonic(), 0.0)).strip()
            if line:
                return line

    def _open(self) -> Link:
        if self._link is None:
            raise DeviceError("The slide is not open: use it as `with GcodeSlide(…) as slide:`.")
        return self._link


class _AlarmError(DeviceError):
    """The controller has locked itself, or has restarted; it stands."""


class _standing_still:  # noqa: N801
    """After any exception inside, the stage stands still."""

    def __init__(self, slide: GcodeSlide) -> None:
        self._slide = slide

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        if problem is not None and not isinstance(problem, _AlarmError):
            try:
                self._slide.stop()
            except DeviceError:
                if isinstance(problem, GeneratorExit):
                    raise
