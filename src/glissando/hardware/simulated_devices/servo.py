"""A simulated XL430-W250 stage in a separate process, on a pseudo-terminal.

`python -m glissando.hardware.simulated_devices.servo` prints the path to open as one line, then
serves until SIGTERM or the end of its standard input. `--travel` sends the carriage's true travel
as datagrams of two little-endian float64: time.monotonic() in seconds and metres.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from glissando.errors import SimulationError
from glissando.hardware.simulated_devices.faults import FaultDraws, parse_faults
from glissando.hardware.simulated_devices.screw import TICKS, Screw
from glissando.hardware.simulated_devices.serving import (
    add_axis_options,
    device_parser,
    finite,
    positive,
    require_axis,
    run_device,
    serve_axis,
)
from glissando.hardware.simulated_devices.xl430 import OVERLOAD, TICK_WRAP, Xl430


@dataclass(frozen=True)
class ServoFaults:
    """Faults of a servo's line by name; all off by default.

    Probabilities for a status packet: `corrupt` with one bit flipped, `short` truncated, `late`
    (probability, seconds of delay). Indices of status packets: from `silent` (index, number) on
    they are lost; from `dead` on the servo neither receives nor answers; at `overload` it raises
    that hardware error, at `restart` it loses power for a moment.
    """

    corrupt: float = 0.0
    short: float = 0.0
    late: tuple[float, float] = (0.0, 0.0)
    silent: tuple[float, float] = (float("inf"), 0.0)
    dead: float = float("inf")
    overload: float = float("inf")
    restart: float = float("inf")


class Line:
    """Line between a servo and its host, with faults; answers keep their order.

    Args:
        servo: The servo.
        faults: Faults of the line; none if None.
        seed: Seed of the faults.
    """

    def __init__(self, servo: Xl430, faults: ServoFaults | None = None, seed: int = 0) -> None:
        self.servo, self.sent = servo, 0
        self.faults = ServoFaults() if faults is None else faults
        self._dice = FaultDraws(self.faults, seed)
        self._last = 0.0  # s, arrival time of the previous answer

    def receive(self, held: bytearray, now: float) -> list[tuple[float, bytes]]:
        """Process bytes from the host; returns arrival time (s) and bytes of each answer."""
        data, answers = bytes(held), []
        held.clear()
        if self.sent >= self.faults.dead:
            return []
        for packet in self.servo.receive(data, now):
            if self.sent == self.faults.overload:
                self.servo.fail(OVERLOAD, now)
            if self.sent == self.faults.restart:
                self.servo.restart(now)
            answers.append(self.corrupted(packet, now))
        return answers

    def corrupted(self, packet: bytes, now: float) -> tuple[float, bytes]:
        """Arrival time of the next status packet, and its bytes after faults."""
        faults, dice, number = self.faults, self._dice, self.sent
        self.sent += 1
        packet = dice.cut(dice.flip(packet, "corrupt", number), "short", number)
        if 0 <= number - faults.silent[0] < faults.silent[1]:
            packet = b""
        share, delay = faults.late
        self._last = max(self._last, now + delay * (dice.draw("late", number) < share))
        return self._last, packet


def _parser() -> argparse.ArgumentParser:
    parser = device_parser("servo", __doc__, ServoFaults)
    add_axis_options(parser)
    add = parser.add_argument
    add("--lead", type=positive, default=0.0254, help="m a revolution")
    add("--direction", type=int, default=1, choices=(1, -1))
    add("--backlash", type=finite, default=0.1e-3, help="m of play in the nut")
    add("--ends", type=finite, nargs=2, default=(-0.002, 0.062), help="hard stops, m")
    add("--start", type=finite, default=0.0, metavar="TRAVEL", help="m")
    add("--clock", type=positive, default=1.0, help="rate of the servo's clock against ours")
    return parser


def _serve(options: argparse.Namespace) -> None:
    require_axis(options.start, options.ends, "m")
    if options.backlash < 0.0:
        raise SimulationError(f"A play of {options.backlash:g} m cannot be; give 0 or more.")
    random = np.random.default_rng(options.seed)
    screw = Screw(
        options.lead, options.direction, options.backlash, tuple(options.ends), options.start,
        random.uniform(0.0, TICKS),
    )  # fmt: skip
    tick = int(random.integers(TICK_WRAP))
    servo = Xl430(screw, now=time.monotonic(), clock=options.clock, tick=tick)
    line = Line(servo, parse_faults(ServoFaults, options.faults), options.seed)
    serve_axis(line.receive, servo.advance, options)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulated stage; returns the exit status."""
    return run_device(_parser(), _serve, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
