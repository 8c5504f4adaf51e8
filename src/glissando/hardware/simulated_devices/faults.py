"""What simulated devices do wrong on request, the same for the same seed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from hashlib import blake2b
from typing import Any, TypeVar

from glissando.errors import SimulationError

_BURST = 5  # frames that a coil is missing at a time
F = TypeVar("F")


def parse_faults(kind: type[F], text: str) -> F:
    """Faults of 'name=number,…', where two numbers stand as 'name=number:number'.

    Args:
        kind: Dataclass of the faults; its defaults say how many numbers each has.
        text: The faults that are not as by default.

    Raises:
        SimulationError: A name is unknown, or numbers are missing.

    >>> parse_faults(AuroraFaults, "crc=0.01,slow_init=3").slow_init
    3.0
    """
    defaults = {entry.name: entry.default for entry in fields(kind)}  # type: ignore[arg-type]
    faults: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        name, _, value = part.strip().partition("=")
        if name not in defaults:
            raise SimulationError(f"{name!r} is no fault; give some of {', '.join(defaults)}.")
        pair = isinstance(defaults[name], tuple)
        try:
            numbers = tuple(float(number) for number in value.split(":"))
        except ValueError:
            numbers = ()
        if len(numbers) != 1 + pair:
            example = "0.1:0.05" if pair else "0.1"
            raise SimulationError(f"Fault {part!r} lacks a number; write {name}={example}.")
        faults[name] = numbers if pair else numbers[0]
    return kind(**faults)


@dataclass(frozen=True)
class AuroraFaults:
    """Faults of a tracker by name; all off.

    Chances of a reply while tracking: `crc` a bit flips, `truncate` its end is lost, `quiet` there
    is none, `repeat` the one before comes again; `crc_setup` a bit flips in one before tracking.
    Chances of a frame: `missing` a coil begins to be for five frames, `out` it is out of the
    volume, `partly` partially, `drop` the frame is left out.

    Numbers of a coil, from 0, or −1 for none: `broken` wire, `srom` absent, `bad_srom` absent and
    not to be replaced. Seconds since tracking began first: `reset` of the frame counter,
    `unplug` and `replug` of coil 0, `cut` of the link until `mended`. `slow_init` s that INIT
    takes; `counter` is the first frame number; `warning` 1 if PINIT warns; `bare` 1 if TX says no
    more of a coil that is unplugged.
    """

    crc: float = 0.0
    truncate: float = 0.0
    quiet: float = 0.0
    repeat: float = 0.0
    crc_setup: float = 0.0
    missing: float = 0.0
    out: float = 0.0
    partly: float = 0.0
    drop: float = 0.0
    broken: float = -1
    srom: float = -1
    bad_srom: float = -1
    reset: float = float("inf")
    unplug: float = float("inf")
    replug: float = float("inf")
    cut: float = float("inf")
    mended: float = float("inf")
    slow_init: float = 0.0
    counter: float = 0
    warning: float = 0
    bare: float = 0


@dataclass(frozen=True)
class FaultDraws:
    """Chances that depend on the seed, on what they are for, and on which time it is.

    Attributes:
        faults: Dataclass whose attributes are chances, among others.
        seed: Seed of all draws.
    """

    faults: Any
    seed: int

    def __call__(self, fault: str, index: int, item: int = 0) -> bool:
        """Whether the fault happens at this frame or reply (of this item)."""
        chance = getattr(self.faults, fault)
        return chance > 0.0 and self.draw(fault, index, item) < chance

    def draw(self, what: str, index: int, item: int = 0) -> float:
        """A number from 0 to 1."""
        key = f"{self.seed}/{what}/{index}/{item}".encode()
        return int.from_bytes(blake2b(key, digest_size=8).digest(), "big") / 2.0**64

    def missing(self, frame: int, coil: int) -> bool:
        """Whether a burst in which the coil is missing reaches this frame."""
        return any(self("missing", frame - k, coil) for k in range(_BURST))

    def flip(self, data: bytes, fault: str, index: int) -> bytes:
        """The bytes with one bit before the last byte flipped, if the fault happens."""
        if not data or not self(fault, index):
            return data
        bit = int(self.draw("bit", index) * 8 * (len(data) - 1))
        out = bytearray(data)
        out[bit // 8] ^= 1 << bit % 8
        return bytes(out)

    def cut(self, data: bytes, fault: str, index: int) -> bytes:
        """The bytes without their end, if the fault happens."""
        return data[: int(self.draw("end", index) * len(data))] if self(fault, index) else data
