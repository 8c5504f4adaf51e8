"""An XL430-W250 that drives a lead screw: instructions, motion, watchdog, hardware errors.

It follows its set point exactly, in the two position modes only, and approaches a new goal as if
from rest. Facts not found in the e-Manual are marked [inferred].
"""

from __future__ import annotations

import math

from glissando.hardware.simulated_devices.dynamixel import ALERT, Do, Fault, Parser, packed
from glissando.hardware.simulated_devices.profile import Profile, to
from glissando.hardware.simulated_devices.registers import ControlTable
from glissando.hardware.simulated_devices.screw import TICKS, Screw

SPEED_UNIT = 0.229 / 60.0 * TICKS  # ticks/s a unit of 0.229 rpm
ACCELERATION_UNIT = 214.577 / 3600.0 * TICKS  # ticks/s² a unit of 214.577 rev/min²
TICK_WRAP = 32768  # ms
OVERLOAD = 0x20
_BOOT = 0.1  # s without an answer after a reboot [inferred]
_PATIENCE = 0.5  # s of a stall at more than half the PWM before an overload [inferred]
_TOUCH = 2.0  # ticks beyond a hard stop without load
_MOVING = 10  # speed in units above which it reports that it moves
_FRICTION = 120  # load in 0.1 % during free motion [inferred]
_MODES = ("torque_enable", "operating_mode", "homing_offset")

_Reply = tuple[int, bytes]  # a status packet's error and parameters


class Xl430:
    """A servo with its motor on a `screw`.

    Args:
        screw: Screw that it turns.
        now: Time at which it is switched on, s.
        clock: Rate of its own clock relative to the host's.
        tick: Initial value of that clock, ms.
    """

    def __init__(
        self,
        screw: Screw | None = None,
        *,
        now: float = 0.0,
        clock: float = 1.0,
        tick: int = 0,
    ) -> None:
        self.screw = Screw() if screw is None else screw
        self.table = ControlTable()
        self._clock = clock
        self._parser = Parser()
        self._profile = Profile(now, self.screw.angle)
        self._switch_on(now, tick)
        self._silent_until = now

    def _switch_on(self, now: float, tick: int = 0) -> None:
        """Reset the registers of the RAM; the count of turns is lost."""
        angle, _ = self._actual(now)
        self._profile = Profile(now, angle)
        self._born, self._tick, self._heard = now, tick, now
        self._silent_until = now + _BOOT
        self._stalled_since: float | None = None
        self._turns = int(TICKS) * math.floor(angle / TICKS)
        self.table.reset(eeprom=False)
        self.table["goal_pwm"] = self.table["pwm_limit"]
        self.table["goal_position"] = self._present(now)

    def _actual(self, now: float) -> tuple[float, float]:
        """Angle in ticks and speed in ticks/s of the screw, limited by the hard stops."""
        angle, speed = self._profile.at(now)
        low, high = self.screw.reach
        return (angle, speed) if low <= angle <= high else (min(max(angle, low), high), 0.0)

    def _present(self, now: float) -> int:
        return math.floor(self._actual(now)[0]) - self._turns + self.table["homing_offset"]

    def _hold_position(self, now: float) -> None:
        """End any motion; the goal becomes the present position."""
        self._profile = Profile(now, self._actual(now)[0])
        self.table["goal_position"] = self._present(now)

    def advance(self, now: float) -> float:
        """Simulate up to `now` s; returns the travel of the carriage in m."""
        limit = 0.02 * self.table["bus_watchdog"]
        if self.table["torque_enable"] and 0.0 < limit < now - self._heard:
            self.table["bus_watchdog"] = -1
            self._hold_position(self._heard + limit)
        angle, _ = self._actual(now)
        if abs(angle - self._profile.at(now)[0]) < _TOUCH:
            self._stalled_since = None
        elif self._stalled_since is None:
            self._stalled_since = now
        elif now - self._stalled_since > _PATIENCE and self._pushes_hard:
            self.fail(OVERLOAD, now)
        return self.screw.turn(angle)

    @property
    def _pushes_hard(self) -> bool:
        return 2 * self.table["goal_pwm"] > self.table["pwm_limit"]

    def fail(self, bits: int, now: float) -> None:
        """Raise hardware errors; those in the shutdown register switch the torque off."""
        self.table["hardware_error"] |= bits
        if bits & self.table["shutdown"]:
            self.table["torque_enable"] = 0
            self._profile = Profile(now, self._actual(now)[0])

    def restart(self, now: float) -> None:
        """Lose power for a moment."""
        self._switch_on(now)

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Process bytes from the bus, and return the status packets that answer them.

        Args:
            data: Bytes of complete or incomplete packets.
            now: Time of their arrival, s.
        """
        answers = []
        for packet in self._parser.feed(data, now):
            if packet.id != self.table["id"] or packet.instruction == Do.STATUS:
                continue
            self.advance(now)
            if now < self._silent_until:
                continue
            error, parameters = int(Fault.CRC), b""
            if packet.sound:
                self._heard = now
                error, parameters = self._execute(packet.instruction, packet.parameters, now)
                error |= ALERT if self.table["hardware_error"] else 0
            answers.append(packed(packet.id, Do.STATUS, bytes([error]) + parameters))
        return answers

    def _execute(self, instruction: int, words: bytes, now: float) -> _Reply:
        if instruction == Do.PING:
            model, firmware = self.table["model"], self.table["firmware"]
            return Fault.NONE, model.to_bytes(2, "little") + bytes([firmware])
        if instruction == Do.READ:
            return self._read(words, now)
        if instruction == Do.WRITE:
            return self._write(words, now), b""
        if instruction == Do.REBOOT:
            self._switch_on(now)
            return Fault.NONE, b""
        return Fault.INSTRUCTION, b""

    def _read(self, words: bytes, now: float) -> _Reply:
        if len(words) != 4:
            return Fault.LENGTH, b""
        self._refresh(now)
        address, size = (int.from_bytes(words[k : k + 2], "little") for k in (0, 2))
        data = self.table.read(address, size)
        return (Fault.ACCESS, b"") if data is None else (Fault.NONE, data)

    def _refresh(self, now: float) -> None:
        """Update the read-only registers."""
        table, (angle, speed) = self.table, self._actual(now)
        intended, _ = self._profile.at(now)
        units = round(speed / SPEED_UNIT)
        if abs(intended - angle) > _TOUCH:  # pressed against a hard stop with the full goal PWM
            effort = math.copysign(1000 * table["goal_pwm"] // 885, intended - angle)
        else:
            effort = math.copysign(_FRICTION, speed) if speed else 0.0
        table["tick"] = (self._tick + int(1000.0 * self._clock * (now - self._born))) % TICK_WRAP
        table["moving"] = int(abs(units) > _MOVING)
        table["load"] = round(effort)
        table["velocity"], table["position"] = units, self._present(now)

    def _write(self, words: bytes, now: float) -> Fault:
        if len(words) < 3:
            return Fault.LENGTH
        fault, changes = self.table.changes(int.from_bytes(words[:2], "little"), words[2:])
        if fault:
            return fault
        if changes.get("torque_enable") and self.table["hardware_error"] & self.table["shutdown"]:
            return Fault.RESULT
        before = [self.table[name] for name in _MODES]
        for name, value in changes.items():
            self.table[name] = value
        if [self.table[name] for name in _MODES] != before:
            self._hold_position(now)
        elif self.table["torque_enable"] and "goal_position" in changes:
            self._start_motion(now)
        return Fault.NONE

    def _start_motion(self, now: float) -> None:
        """Begin the motion to the goal, with the profile of the registers."""
        table = self.table
        goal = table["goal_position"] + 0.5 + self._turns - table["homing_offset"]
        cruise = SPEED_UNIT * table["profile_velocity"]
        acceleration = ACCELERATION_UNIT * table["profile_acceleration"] if cruise else 0.0
        speed = cruise or SPEED_UNIT * table["velocity_limit"]
        angle, _ = self._actual(now)
        self._profile = to(now, angle, goal, speed=speed, acceleration=acceleration)
