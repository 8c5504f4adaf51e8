"""What a simulated Aurora does wrong on request, the same for the same seed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from hashlib import blake2b
from typing import Any

from glissando.errors import SimulationError

_BURST = 5  # frames a coil is missing when it is


@dataclass(frozen=True)
class Faults:
    """Faults by name; all off.

    Chances of a reply while tracking: `crc` a bit flips, `truncate` its end is lost, `quiet` there
    is none, `repeat` the one before comes again; `crc_setup` a bit flips in one before tracking.
    Chances of a frame: `missing` a coil begins to be for five frames, `out` it is out of the
    volume, `partly` partially, `sign` its quaternion changes sign, `drop` the frame is left out.

    Numbers of a coil, from 0, or −1 for none: `broken` wire, `srom` absent, `bad_srom` absent and
    not to be replaced. Seconds since tracking began first: `reset` of the frame counter,
    `unplug` and `replug` of coil 0, `cut` of the link until `mended`. `slow_init` s that INIT
    takes; `counter` is the first frame number; `metal` m of distortion that nobody is told of;
    `warning` 1 if PINIT warns; `bare` 1 if TX says no more of a coil that is unplugged.
    """

    crc: float = 0.0
    truncate: float = 0.0
    quiet: float = 0.0
    repeat: float = 0.0
    crc_setup: float = 0.0
    missing: float = 0.0
    out: float = 0.0
    partly: float = 0.0
    sign: float = 0.0
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
    metal: float = 0.0
    warning: float = 0
    bare: float = 0

    @staticmethod
    def parse(text: str) -> Faults:
        """Faults of 'name=number,…'. Raises SimulationError.

        >>> Faults.parse("crc=0.01,slow_init=3").slow_init
        3.0
        """
        known = {entry.name for entry in fields(Faults)}
        given: dict[str, Any] = {}
        for part in filter(None, text.split(",")):
            name, _, value = part.strip().partition("=")
            if name not in known:
                raise SimulationError(f"{name!r} is no fault; name some of {', '.join(known)}.")
            try:
                given[name] = float(value)
            except ValueError:
                raise SimulationError(f"Fault {part!r} has no number; write {name}=0.1.") from None
        return Faults(**given)


@dataclass(frozen=True)
class Dice:
    """Chances that depend on the seed, on what they are for, and on which time it is."""

    faults: Faults
    seed: int

    def __call__(self, fault: str, index: int, coil: int = 0) -> bool:
        """Whether the fault happens at this frame or reply (of this coil)."""
        chance = getattr(self.faults, fault)
        return chance > 0.0 and self.draw(fault, index, coil) < chance

    def draw(self, what: str, index: int, coil: int = 0) -> float:
        """A number from 0 to 1."""
        key = f"{self.seed}/{what}/{index}/{coil}".encode()
        return int.from_bytes(blake2b(key, digest_size=8).digest(), "big") / 2.0**64

    def missing(self, frame: int, coil: int) -> bool:
        """Whether a burst in which the coil is missing reaches this frame."""
        return any(self("missing", frame - k, coil) for k in range(_BURST))

    def spoil(self, reply: bytes, fault: str, index: int) -> bytes:
        """The reply with one bit other than its end's flipped, if the fault happens."""
        if not reply or not self(fault, index):
            return reply
        bit = int(self.draw("bit", index) * 8 * (len(reply) - 1))
        out = bytearray(reply)
        out[bit // 8] ^= 1 << bit % 8
        return bytes(out)
