"""The control table of an XL430-W250: what stands where, how large, and what may be written.

Source: ROBOTIS e-Manual, "XL430-W250".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from glissando.hardware.simulated_devices.dynamixel import Fault

EEPROM_END = 64
GOALS = {1: "goal_velocity", 3: "goal_position", 4: "goal_position", 16: "goal_pwm"}  # by mode
_INDIRECT = ((168, 224, 28), (578, 634, 28))  # where addresses stand, where their data, how many
SIZE = 662


@dataclass(frozen=True)
class Register:
    """One entry; `low` is None where it can only be read."""

    name: str
    address: int
    size: int
    initial: int = 0
    low: int | None = None
    high: int = 0


_ROWS: tuple[tuple[Any, ...], ...] = (
    ("model", 0, 2, 1060),
    ("information", 2, 4),
    ("firmware", 6, 1, 45),
    ("id", 7, 1, 1, 0, 252),
    ("baud", 8, 1, 1, 0, 7),
    ("return_delay", 9, 1, 250, 0, 254),
    ("drive_mode", 10, 1, 0, 0, 13),
    ("operating_mode", 11, 1, 3, 1, 16),
    ("shadow_id", 12, 1, 255, 0, 255),
    ("protocol", 13, 1, 2, 2, 2),
    ("homing_offset", 20, 4, 0, -1_044_479, 1_044_479),
    ("moving_threshold", 24, 4, 10, 0, 1023),
    ("temperature_limit", 31, 1, 72, 0, 100),
    ("max_voltage", 32, 2, 140, 60, 140),
    ("min_voltage", 34, 2, 60, 60, 140),
    ("pwm_limit", 36, 2, 885, 0, 885),
    ("velocity_limit", 44, 4, 265, 0, 1023),
    ("max_position", 48, 4, 4095, 0, 4095),
    ("min_position", 52, 4, 0, 0, 4095),
    ("startup", 60, 1, 0, 0, 3),
    ("shutdown", 63, 1, 52, 0, 63),
    ("torque_enable", 64, 1, 0, 0, 1),
    ("led", 65, 1, 0, 0, 1),
    ("status_return", 68, 1, 2, 0, 2),
    ("registered", 69, 1),
    ("hardware_error", 70, 1),
    ("velocity_i", 76, 2, 1000, 0, 16383),
    ("velocity_p", 78, 2, 100, 0, 16383),
    ("position_d", 80, 2, 4000, 0, 16383),
    ("position_i", 82, 2, 0, 0, 16383),
    ("position_p", 84, 2, 640, 0, 16383),
    ("feedforward_2", 88, 2, 0, 0, 16383),
    ("feedforward_1", 90, 2, 0, 0, 16383),
    ("bus_watchdog", 98, 1, 0, -1, 127),
    ("goal_pwm", 100, 2, 885, -885, 885),
    ("goal_velocity", 104, 4, 0, -1023, 1023),
    ("profile_acceleration", 108, 4, 0, 0, 32767),
    ("profile_velocity", 112, 4, 0, 0, 32767),
    ("goal_position", 116, 4, 0, -1_048_575, 1_048_575),
    ("tick", 120, 2),
    ("moving", 122, 1),
    ("moving_status", 123, 1),
    ("pwm", 124, 2),
    ("load", 126, 2),
    ("velocity", 128, 4),
    ("position", 132, 4),
    ("velocity_trajectory", 136, 4),
    ("position_trajectory", 140, 4),
    ("voltage", 144, 2, 120),
    ("temperature", 146, 1, 35),
)
REGISTERS = [Register(*row) for row in _ROWS]
for _addresses, _data, _count in _INDIRECT:
    REGISTERS += [
        Register(f"indirect_{_addresses + 2 * k}", _addresses + 2 * k, 2, _data + k, 0, SIZE - 1)
        for k in range(_count)
    ]
_BY_NAME = {register.name: register for register in REGISTERS}
_AT = {register.address: register for register in REGISTERS}
Change = tuple[Register, int]


class ControlTable:
    """The registers' values."""

    def __init__(self) -> None:
        self._bytes = bytearray(SIZE)
        self.reset()

    def reset(self, *, eeprom: bool = True, keep: tuple[str, ...] = ()) -> None:
        """Initial values; of the RAM alone unless `eeprom`."""
        for register in REGISTERS:
            if (eeprom or register.address >= EEPROM_END) and register.name not in keep:
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

    def _place(self, address: int) -> int:
        """Where the byte at an address really stands; an indirect one elsewhere."""
        for addresses, data, count in _INDIRECT:
            if data <= address < data + count:
                return self[f"indirect_{addresses + 2 * (address - data)}"]
        return address

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes from an address on; None beyond the table. Gaps read as zero [inferred]."""
        if size < 1 or address + size > SIZE:
            return None
        return bytes(self._bytes[self._place(address + k)] for k in range(size))

    def changes(self, address: int, data: bytes) -> tuple[Fault, list[Change]]:
        """What writing would change, or the first fault in it; nothing is written yet."""
        if not data:
            return Fault.LENGTH, []
        places = [self._place(address + k) for k in range(len(data))]
        found: list[Change] = []
        k = 0
        while k < len(data):
            register = _AT.get(places[k])
            if register is None or register.low is None:
                return Fault.ACCESS, []
            if register.address < EEPROM_END and self["torque_enable"]:
                return Fault.ACCESS, []
            size = register.size
            if places[k : k + size] != list(range(register.address, register.address + size)):
                return Fault.LENGTH, []
            value = int.from_bytes(data[k : k + size], "little", signed=register.low < 0)
            if not register.low <= value <= register.high:
                return Fault.RANGE, []
            found.append((register, value))
            k += size
        return self._judged(found), found

    def _judged(self, found: list[Change]) -> Fault:
        """Values within their own range may still break limits that other registers set."""
        for register, value in found:
            if register.name == "operating_mode" and value not in GOALS:
                return Fault.RANGE
            if register.name in GOALS.values() and self["bus_watchdog"] == -1:
                return Fault.RANGE  # goals can only be read until the watchdog is cleared
            if register.name == "goal_pwm" and abs(value) > self["pwm_limit"]:
                return Fault.LIMIT
            fast = register.name in ("goal_velocity", "profile_velocity")
            if fast and abs(value) > self["velocity_limit"]:
                return Fault.LIMIT
            inside = self["min_position"] <= value <= self["max_position"]
            if register.name == "goal_position" and self["operating_mode"] == 3 and not inside:
                return Fault.LIMIT
        return Fault.NONE
