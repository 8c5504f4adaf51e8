"""A simulated XL430-W250 stage in a process of its own, on a pseudo-terminal.

`python -m glissando.hardware.simulated_devices.servo` prints the path to open as one line, then
serves until SIGTERM or the end of its standard input. `--travel` sends the carriage's true travel
as datagrams of two little-endian float64: time.monotonic() in seconds and metres.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pty
import select
import signal
import socket
import struct
import sys
import time
import tty
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

import numpy as np

from glissando.errors import DeviceError
from glissando.hardware.simulated_devices.dynamixel import Bus
from glissando.hardware.simulated_devices.screw import TICKS, Screw
from glissando.hardware.simulated_devices.servo_faults import Faults, Line
from glissando.hardware.simulated_devices.xl430 import OVERLOAD, TICK_WRAP, Xl430

_PERIOD = 0.005  # s between datagrams


class Stage:
    """A servo, others on its bus, and the line between them and the host."""

    def __init__(self, servo: Xl430, others: Sequence[Xl430], line: Line) -> None:
        self.servo, self.line = servo, line
        self._bus = Bus([servo, *others])
        self._waiting: list[tuple[float, bytes]] = []

    def hear(self, data: bytes, now: float) -> None:
        """Bytes from the host."""
        if self.line.dead:
            return
        for packet in self._bus.receive(data, now):
            if self.line.sent == self.line.faults.overload:
                self.servo.fail(OVERLOAD, now)
            if self.line.sent == self.line.faults.restart:
                self.servo.restart(now)
            self._waiting.append(self.line.spoil(packet, now))

    def say(self, now: float) -> bytes:
        """Bytes for the host that are due, in the order of their instructions."""
        told = b""
        while self._waiting and self._waiting[0][0] <= now:
            told += self._waiting.pop(0)[1]
        return told

    @property
    def next_due(self) -> float:
        """When there will be more to say; infinity if nothing waits."""
        return self._waiting[0][0] if self._waiting else float("inf")


def serve(stage: Stage, line: int, travel: tuple[str, int] | None) -> None:
    """Answer on a pseudo-terminal's file and tell travel, until standard input ends."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    beat = time.monotonic()
    with sender:
        while True:
            wait = max(min(beat, stage.next_due) - time.monotonic(), 0.0)
            ready, _, _ = select.select([line, sys.stdin], [], [], wait)
            now = time.monotonic()
            if sys.stdin in ready and not os.read(sys.stdin.fileno(), 4096):
                return
            if line in ready:
                stage.hear(os.read(line, 4096), now)
            if told := stage.say(now):
                with contextlib.suppress(BlockingIOError):  # a host that never reads loses bytes
                    os.write(line, told)
            if now >= beat:
                beat = max(beat + _PERIOD, now)
                place = stage.servo.advance(now)
                if travel:
                    with contextlib.suppress(OSError):  # nobody listens yet, or any more
                        sender.sendto(struct.pack("<dd", now, place), travel)


@contextlib.contextmanager
def terminal(link: Path | None) -> Iterator[tuple[int, str]]:
    """A raw pseudo-terminal: the file to serve on and the path to open, a link to it if given."""
    ours, theirs = pty.openpty()
    try:
        tty.setraw(ours)
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        path = os.ttyname(theirs)
        if link:
            link.unlink(missing_ok=True)
            link.symlink_to(path)
        try:
            yield ours, str(link or path)
        finally:
            if link:
                link.unlink(missing_ok=True)
    finally:
        os.close(ours)
        os.close(theirs)  # kept open until now: a host may come and go


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not (host and port.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is no HOST:PORT")
    return host, int(port)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="servo", description=__doc__)
    add = parser.add_argument
    add("--pty", type=Path, metavar="LINK", help="make this link to the pseudo-terminal")
    add("--travel", type=_address, metavar="HOST:PORT", help="send true travel there, 200 Hz")
    add("--faults", nargs="*", default=[], metavar="FAULT", help="see faults.py")
    add("--seed", type=int, default=0, help="of the faults, the angle and the clock at the start")
    add("--lead", type=float, default=0.0254, help="m a revolution")
    add("--direction", type=int, default=1, choices=(1, -1))
    add("--backlash", type=float, default=0.1e-3, help="m of play in the nut")
    add("--ends", type=float, nargs=2, default=(-0.002, 0.062), help="hard stops, m")
    add("--start", type=float, default=0.0, metavar="TRAVEL", help="m")
    add("--clock", type=float, default=1.0, help="rate of the servo's clock against ours")
    add("--ids", type=int, nargs="+", default=[1], help="servos on the bus; the first is the stage")
    return parser


def _made(options: argparse.Namespace) -> Stage:
    random = np.random.default_rng(options.seed)
    now = time.monotonic()
    screw = Screw(
        options.lead,
        options.direction,
        options.backlash,
        tuple(options.ends),
        options.start,
        random.uniform(0.0, TICKS),
    )
    tick = int(random.integers(TICK_WRAP))
    first, *rest = options.ids
    servo = Xl430(screw, identity=first, now=now, clock=options.clock, tick=tick)
    others = [Xl430(Screw(ends=(-1.0, 1.0)), identity=identity, now=now) for identity in rest]
    return Stage(servo, others, Line(Faults.read(options.faults), options.seed))


def _stop(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulated stage; the exit status."""
    signal.signal(signal.SIGTERM, _stop)
    try:
        options = _parser().parse_args(arguments)
        stage = _made(options)
        with terminal(options.pty) as (line, path):
            print(path, flush=True)
            serve(stage, line, options.travel)
    except DeviceError as problem:
        print(problem, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
