"""A simulated GRBL 1.1 controller with one moving axis, in a separate process.

`python -m glissando.hardware.simulated_devices.grbl` prints the path to open as one line, then
serves until SIGTERM or the end of its standard input. `--travel` sends the carriage's true travel
as datagrams of two little-endian float64: time.monotonic() in seconds and metres.
"""

from __future__ import annotations

import argparse
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from glissando.hardware.simulated_devices.faults import FaultDraws, parse_faults
from glissando.hardware.simulated_devices.serving import (
    add_axis_options,
    device_parser,
    finite,
    require_axis,
    run_device,
    serve_axis,
)

_BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
_PLANNER = 15  # largest number of queued motions
_JOG = re.compile(r"\$J=(G53)?G90G21([XYZ])(-?\d+\.?\d*)F(\d+\.?\d*)")


@dataclass(frozen=True)
class GrblFaults:
    """Faults of a controller by name; all off by default.

    Probabilities for a reply: `corrupt` with one bit flipped, `lost`. Indices of replies: from
    `dead` on the controller neither receives nor answers; at `alarm` a limit switch trips; at
    `restart` its supply fails for a moment.
    """

    corrupt: float = 0.0
    lost: float = 0.0
    dead: float = float("inf")
    alarm: float = float("inf")
    restart: float = float("inf")


@dataclass
class Grbl:
    """The controller: replies to bytes, and an axis with trapezoidal speed profiles.

    Attributes:
        limits: Machine positions (low, high) of the axis, mm; homing ends near the low end.
        acceleration: Acceleration of the axis, mm/s².
        fastest: Largest speed of the axis, mm/s ($110 / 60).
        place: Machine position, mm.
        state: State as in status reports.
        work: Machine position of the work coordinates' origin, mm, for jogs without G53.
        lost: True position at machine position zero after a loss of position, mm.
    """

    limits: tuple[float, float] = (-2.0, 62.0)
    acceleration: float = 500.0
    fastest: float = 100.0
    place: float = 0.0
    state: str = "Idle"
    work: float = -7.5
    lost: float = field(default=0.0, init=False)
    speed: float = field(default=0.0, init=False)  # mm/s, signed
    jogs: deque[tuple[float, float]] = field(default_factory=deque, init=False)
    now: float | None = field(default=None, init=False)
    letters: bytearray = field(default_factory=bytearray, init=False)

    def advance(self, now: float) -> float:
        """Simulate up to time `now` in s; returns the machine position in mm."""
        self.now = now if self.now is None else self.now
        while self.now < now:
            step = min(1e-3, now - self.now)
            self.now += step
            self._step(step)
        return self.place

    def _step(self, step: float) -> None:
        if self.state != "Jog":
            return
        change = self.acceleration * step
        if not self.jogs:
            slower = max(abs(self.speed) - change, 0.0)
            self.speed = slower if self.speed > 0.0 else -slower
            self.place += self.speed * step
            if not self.speed:
                self.state = "Idle"
            return
        goal, feed = self.jogs[0]
        remaining = goal - self.place
        ahead = len(self.jogs) > 1 and (self.jogs[1][0] - goal) * remaining > 0.0
        braking = feed if ahead else (2.0 * self.acceleration * abs(remaining)) ** 0.5
        aim = min(feed, self.fastest, braking) * (1.0 if remaining > 0.0 else -1.0)
        self.speed += min(max(aim - self.speed, -change), change)
        self.place += self.speed * step
        if (goal - self.place) * remaining <= 0.0 or abs(goal - self.place) < 1e-4:
            self.jogs.popleft()
            if not self.jogs:
                self.place, self.speed, self.state = goal, 0.0, "Idle"

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Process bytes from the host, and return the replies."""
        self.advance(now)
        out = []
        for byte in data:
            if byte == ord("?"):
                out.append(self._report())
            elif byte == 0x18:
                moving = self.state == "Jog"
                self.jogs.clear()
                self.letters.clear()
                self.speed, self.state = 0.0, "Alarm" if moving else self.state
                out.append(_BANNER)
            elif byte in (0x85, ord("!")):
                self.jogs.clear()  # a feed hold ends a jog as a jog cancel does
            elif byte in b"\r\n":
                if self.letters:
                    out.append(self._execute(self.letters.decode("ascii", "replace")))
                self.letters.clear()
            elif byte < 0x80:
                self.letters.append(byte)
        return out

    def restart(self) -> bytes:
        """Lose speed, jogs and position, as when the supply fails for a moment."""
        self.lost, self.place = self.lost + self.place, 0.0
        self.jogs.clear()
        self.letters.clear()
        self.speed, self.state = 0.0, "Idle"
        return _BANNER

    def _report(self) -> bytes:
        feed = 60.0 * abs(self.speed)
        return f"<{self.state}|MPos:{self.place:.3f},0.000,0.000|FS:{feed:.0f},0>\r\n".encode()

    def _execute(self, line: str) -> bytes:
        if line == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            return b"[MSG:Caution: Unlocked]\r\nok\r\n"
        if line == "$H":
            self.place, self.state = self.limits[0] + 1.0, "Idle"
            return b"ok\r\n"
        if self.state == "Alarm":
            return b"error:9\r\n"
        jog = _JOG.fullmatch(line)
        if jog is None or jog[2] != "X" or float(jog[4]) <= 0.0:
            return b"error:16\r\n"
        goal = float(jog[3]) + (0.0 if jog[1] else self.work)
        if not self.limits[0] <= goal <= self.limits[1]:
            return b"error:15\r\n"
        if len(self.jogs) < _PLANNER:
            self.jogs.append((goal, float(jog[4]) / 60.0))
            self.state = "Jog"
        return b"ok\r\n"


def _parser() -> argparse.ArgumentParser:
    parser = device_parser("grbl", __doc__, GrblFaults)
    add_axis_options(parser)
    add = parser.add_argument
    add("--limits", type=finite, nargs=2, default=(-2.0, 62.0), help="machine positions, mm")
    add("--start", type=finite, default=0.0, metavar="MM", help="machine position at the start")
    add("--locked", action="store_true", help="homing is required ($22=1): begins in alarm")
    return parser


def _serve(options: argparse.Namespace) -> None:
    require_axis(options.start, options.limits, "mm")
    state = "Alarm" if options.locked else "Idle"
    device = Grbl(tuple(options.limits), place=options.start, state=state)
    faults = parse_faults(GrblFaults, options.faults)
    dice, sent = FaultDraws(faults, options.seed), 0

    def receive(held: bytearray, now: float) -> list[tuple[float, bytes]]:
        nonlocal sent
        data, out = bytes(held), []
        held.clear()
        for reply in device.receive(data, now) if sent < faults.dead else []:
            if sent == faults.alarm:
                device.jogs.clear()
                device.speed, device.state, reply = 0.0, "Alarm", b"ALARM:1\r\n" + reply
            if sent == faults.restart:
                reply = device.restart()
            if dice.draw("lost", sent) >= faults.lost:
                out.append((now, dice.flip(reply, "corrupt", sent)))
            sent += 1
        return out

    serve_axis(receive, lambda now: 1e-3 * (device.advance(now) + device.lost), options)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulated controller; returns the exit status."""
    return run_device(_parser(), _serve, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
