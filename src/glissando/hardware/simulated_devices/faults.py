"""Faults of simulated devices on request, reproducible by their seed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from hashlib import blake2b
from typing import Any, TypeVar

from glissando.errors import SimulationError

_BURST = 5  # successive frames in which a coil is missing
F = TypeVar("F")


def parse_faults(kind: type[F], text: str) -> F:
    """Parse faults of the form 'name=number,…'; a pair is 'name=number:number'.

    Args:
        kind: Dataclass of the faults, whose defaults determine how many numbers each has.
        text: Faults that differ from the defaults.

    Raises:
        SimulationError: A name is unknown, or a number is missing.

    >>> parse_faults(AuroraFaults, "crc=0.01,slow_init=3").slow_init
    3.0
    """
    defaults = {entry.name: entry.default for entry in fields(kind)}  # type: ignore[arg-type]
    faults: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        name, _, value = part.strip().partition("=")
        if name not in defaults:
            raise SimulationError(f"{name!r} is not a fault; give some of {', '.join(defaults)}.")
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
    """Faults of a tracker by name; all off by default.

    Probabilities for a reply while tracking: `crc` one bit is flipped, `truncate` its end is lost,
    `quiet` it is lost, `repeat` the previous one is sent again; before tracking, `crc_setup` one
    bit is flipped. Probabilities for a frame: `missing` a coil begins to be missing for five
    frames, `out` it is outside the volume, `partly` partially, `drop` the frame is dropped.

    Indices of a coil, from 0, or −1 for none: `broken` wire, `srom` absent, `bad_srom` absent and
    not replaceable. Seconds after tracking first began: `reset` of the frame counter, `unplug` and
    `replug` of coil 0, `cut` of the link until `mended`. `slow_init` is the duration of INIT in s;
    `counter` is the first frame number; `warning` is 1 if PINIT warns; `bare` is 1 if TX omits
    status and frame number of an unplugged coil.
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
    """Reproducible random draws, determined by the seed, the fault, and the frame or reply.

    Attributes:
        faults: Dataclass with probabilities among its attributes.
        seed: Seed of all draws.
    """

    faults: Any
    seed: int

    def __call__(self, fault: str, index: int, item: int = 0) -> bool:
        """Whether the fault occurs at this frame or reply (for this item)."""
        chance = getattr(self.faults, fault)
        return chance > 0.0 and self.draw(fault, index, item) < chance

    def draw(self, what: str, index: int, item: int = 0) -> float:
        """Uniform random number in [0, 1)."""
        key = f"{self.seed}/{what}/{index}/{item}".encode()
        return int.from_bytes(blake2b(key, digest_size=8).digest(), "big") / 2.0**64

    def missing(self, frame: int, coil: int) -> bool:
        """Whether the coil is missing in this frame, because a burst has begun recently."""
        return any(self("missing", frame - k, coil) for k in range(_BURST))

    def flip(self, data: bytes, fault: str, index: int) -> bytes:
        """Bytes with one bit before the last byte flipped, if the fault occurs."""
        if not data or not self(fault, index):
            return data
        bit = int(self.draw("bit", index) * 8 * (len(data) - 1))
        out = bytearray(data)
        out[bit // 8] ^= 1 << bit % 8
        return bytes(out)

    def cut(self, data: bytes, fault: str, index: int) -> bytes:
        """Bytes without a random part of their end, if the fault occurs."""
        return data[: int(self.draw("end", index) * len(data))] if self(fault, index) else data
