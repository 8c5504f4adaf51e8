"""Ports of a simulated Aurora: handles assigned, initialised, enabled and freed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from glissando.hardware.simulated_devices.scene import SceneCoil


class CommandError(Exception):
    """The device refuses a command; the argument is the error number."""


@dataclass
class Port:
    """A handle and the coil that is plugged in at it.

    Attributes:
        handle: Number of the handle.
        coil: Index of the coil in the scene.
        place: The coil.
        memory: Bytes of a virtual SROM written so far; negative if the coil needs none.
    """

    handle: int
    coil: int
    place: SceneCoil
    occupied: bool = True
    initialised: bool = False
    enabled: bool = False
    memory: int = 0

    @property
    def status(self) -> int:
        """Status bits of PHSR and PHINF."""
        return self.occupied * 0x01 | self.initialised * 0x10 | self.enabled * 0x20

    @property
    def lists(self) -> tuple[int, int]:
        """Lists of PHSR that contain the port."""
        if not self.occupied:
            return 0, 1
        return 0, 4 if self.enabled else 3 if self.initialised else 2


class Ports:
    """All handles, in the order of their assignment.

    Args:
        coils: The coils that are plugged in.
        without_memory: Indices of those without SROM.
        hopeless: Index of a coil whose SROM cannot be replaced by a virtual one.
    """

    def __init__(self, coils: Sequence[SceneCoil], without_memory: set[int], hopeless: int):
        self._coils, self._without, self._hopeless = coils, without_memory, hopeless
        self.clear()

    def clear(self) -> None:
        """Assign all handles anew, from 0A, as after a reset."""
        self.all: list[Port] = []
        for coil in range(len(self._coils)):
            self.plug(coil)

    def plug(self, coil: int) -> None:
        """Plug a coil in at a new handle."""
        used = {port.handle for port in self.all}
        handle = next(h for h in range(0x0A, 0x80) if h not in used)
        memory = 0 if coil in self._without else -1
        self.all.append(Port(handle, coil, self._coils[coil], memory=memory))

    def unplug(self, coil: int) -> None:
        """Unplug a coil; its handle remains until it is freed."""
        for port in self.all:
            if port.coil == coil:
                port.occupied = False

    def listed(self, which: int) -> list[Port]:
        """Ports in a list of PHSR: 0 all, 1 to free, 2 to initialise, 3 to enable, 4 enabled."""
        if which not in range(5):
            raise CommandError(0x23)
        return [port for port in self.all if self._shown(port) and which in port.lists]

    def _shown(self, port: Port) -> bool:
        """Whether the port is known: the second coil of a plug is so after the first's PINIT."""
        return port.place.channel == 0 or any(
            other.initialised and other.place.port == port.place.port
            for other in self.all
            if other.place.channel == 0
        )

    def at(self, digits: str) -> Port:
        """Port of a handle in two hexadecimal digits."""
        try:
            handle = int(digits[:2], 16)
        except ValueError:
            raise CommandError(0x08) from None
        for port in self.all:
            if port.handle == handle and self._shown(port):
                return port
        raise CommandError(0x08)

    def free(self, digits: str) -> None:
        """PHF: free a handle; a coil that is still plugged in gets a new one."""
        port = self.at(digits)
        self.all.remove(port)
        if port.occupied:
            self.plug(port.coil)

    def write(self, text: str) -> None:
        """PVWR: write 64 bytes of a virtual SROM."""
        port = self.at(text)
        if len(text) != 2 + 4 + 128:
            raise CommandError(0x03 if len(text) < 134 else 0x02)
        if port.memory >= 0 and port.coil != self._hopeless:
            port.memory += 64

    def configure(self, digits: str) -> None:
        """TTCFG: use the default configuration in place of a memory."""
        port = self.at(digits)
        if port.memory >= 0 and port.coil != self._hopeless:
            port.memory = 1024

    def initialise(self, digits: str) -> None:
        """PINIT: initialise a port."""
        port = self.at(digits)
        if not port.occupied:
            raise CommandError(0x2C)
        if 0 <= port.memory < 1024:
            raise CommandError(0x13)
        port.initialised = True

    def enable(self, text: str) -> None:
        """PENA: enable a port."""
        port = self.at(text)
        if text[2:].upper() not in ("", "S", "D", "B"):
            raise CommandError(0x23)
        if not port.occupied:
            raise CommandError(0x2C)
        if not port.initialised:
            raise CommandError(0x0E)
        port.enabled = True

    def describe(self, text: str) -> str:
        """PHINF: information on a port, general (bit 0) and position on the plugs (bit 5)."""
        port = self.at(text)
        try:
            bits = int(text[2:] or "0001", 16)
        except ValueError:
            raise CommandError(0x07) from None
        if not port.occupied:
            return "UNOCCUPIED"
        # 5-DOF coils are probes (02); the maker's name has 12 characters, the serial number 8.
        serial = f"{0x3A000000 + port.coil:08X}"
        parts = {
            0x01: f"02100000{'SIMULATED':<12}001{serial}{port.status:02X}".ljust(33),
            0x20: f"{'AURORA-0':<8}00{port.place.port + 1:02d}{port.place.channel:02d}",
        }
        return "".join(part for bit, part in parts.items() if bits & bit)
