"""Control table of an XL430-W250: address, size and allowed values of each register.

Source: ROBOTIS e-Manual, "XL430-W250". Registers without effect on the simulated motion are
omitted and read as zero.
"""

from __future__ import annotations

from typing import NamedTuple

from glissando.hardware.simulated_devices.dynamixel import Fault

_EEPROM_END = 64
_SIZE = 662
_GOALS = ("goal_position", "goal_pwm")


class Register(NamedTuple):
    """One register; `low` is None if it is read-only."""

    name: str
    address: int
    size: int
    initial: int = 0
    low: int | None = None
    high: int = 0


_REGISTERS = (
    Register("model", 0, 2, 1060),
    Register("firmware", 6, 1, 45),
    Register("id", 7, 1, 1, 0, 252),
    Register("drive_mode", 10, 1, 0, 0, 13),
    Register("operating_mode", 11, 1, 3, 3, 4),  # position, or extended position
    Register("homing_offset", 20, 4, 0, -1_044_479, 1_044_479),
    Register("pwm_limit", 36, 2, 885, 0, 885),
    Register("velocity_limit", 44, 4, 265, 0, 1023),
    Register("max_position", 48, 4, 4095, 0, 4095),
    Register("min_position", 52, 4, 0, 0, 4095),
    Register("shutdown", 63, 1, 52, 0, 63),
    Register("torque_enable", 64, 1, 0, 0, 1),
    Register("led", 65, 1, 0, 0, 1),
    Register("hardware_error", 70, 1),
    Register("bus_watchdog", 98, 1, 0, -1, 127),
    Register("goal_pwm", 100, 2, 885, -885, 885),
    Register("profile_acceleration", 108, 4, 0, 0, 32767),
    Register("profile_velocity", 112, 4, 0, 0, 32767),
    Register("goal_position", 116, 4, 0, -1_048_575, 1_048_575),
    Register("tick", 120, 2),
    Register("moving", 122, 1),
    Register("load", 126, 2),
    Register("velocity", 128, 4),
    Register("position", 132, 4),
)
_BY_NAME = {register.name: register for register in _REGISTERS}
_BY_ADDRESS = {register.address: register for register in _REGISTERS}


class ControlTable:
    """Values of the registers, by name."""

    def __init__(self) -> None:
        self._bytes = bytearray(_SIZE)
        self.reset(eeprom=True)

    def reset(self, *, eeprom: bool) -> None:
        """Set initial values; of the RAM only, unless `eeprom`."""
        for register in _REGISTERS:
            if eeprom or register.address >= _EEPROM_END:
                self[register.name] = register.initial

    def __getitem__(self, name: str) -> int:
        register = _BY_NAME[name]
        end = register.address + register.size
        signed = (register.low or 0) < 0
        return int.from_bytes(self._bytes[register.address : end], "little", signed=signed)

    def __setitem__(self, name: str, value: int) -> None:
        register = _BY_NAME[name]
        word = (value % (1 << 8 * register.size)).to_bytes(register.size, "little")
        self._bytes[register.address : register.address + register.size] = word

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes from an address; None beyond the table. Gaps read as zero [inferred]."""
        end = address + size
        return bytes(self._bytes[address:end]) if size > 0 and end <= _SIZE else None

    def changes(self, address: int, data: bytes) -> tuple[Fault, dict[str, int]]:
        """Registers that a write would change, or its first fault; nothing is written."""
        changes: dict[str, int] = {}
        end = address + len(data)
        while address < end:
            register = _BY_ADDRESS.get(address)
            if register is None or register.low is None:
                return Fault.ACCESS, {}
            if register.address < _EEPROM_END and self["torque_enable"]:
                return Fault.ACCESS, {}
            if address + register.size > end:
                return Fault.LENGTH, {}
            word, data = data[: register.size], data[register.size :]
            value = int.from_bytes(word, "little", signed=register.low < 0)
            if not register.low <= value <= register.high:
                return Fault.RANGE, {}
            changes[register.name] = value
            address += register.size
        return self._limit_fault(changes), changes

    def _limit_fault(self, changes: dict[str, int]) -> Fault:
        """Fault of values that violate limits set in other registers."""
        if self["bus_watchdog"] == -1 and not changes.keys().isdisjoint(_GOALS):
            return Fault.RANGE  # goals are read-only until the watchdog is cleared
        goal = changes.get("goal_position", self["min_position"])
        outside = not self["min_position"] <= goal <= self["max_position"]
        beyond = (
            abs(changes.get("goal_pwm", 0)) > self["pwm_limit"]
            or changes.get("profile_velocity", 0) > self["velocity_limit"]
            or (outside and self["operating_mode"] == 3)
        )
        return Fault.LIMIT if beyond else Fault.NONE
