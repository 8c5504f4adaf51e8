"""An XL430-W250 that drives a lead screw: instructions, motion, watchdog, hardware errors.

Its set point is followed exactly. Facts not found in the e-Manual are marked [inferred].
"""

from __future__ import annotations

import math

from glissando.hardware.simulated_devices.dynamixel import ALERT, Do, Fault, Reply
from glissando.hardware.simulated_devices.profile import Profile, at_speed, to
from glissando.hardware.simulated_devices.registers import GOALS, Change, ControlTable
from glissando.hardware.simulated_devices.screw import TICKS, Screw

SPEED_UNIT = 0.229 / 60.0 * TICKS  # ticks/s a unit of 0.229 rpm
ACCELERATION_UNIT = 214.577 / 3600.0 * TICKS  # ticks/s² a unit of 214.577 rev/min²
TICK_WRAP = 32768  # ms
OVERLOAD = 0x20
_CLEAR = bytes([0x01, 0x44, 0x58, 0x4C, 0x22])
_BOOT = 0.1  # s without an answer after a reboot [inferred]
_PATIENCE = 0.5  # s of a stall at more than half the PWM until overload [inferred]
_TOUCH = 2.0  # ticks beyond a hard end that are no push yet
_FRICTION = 120  # load in 0.1 % while moving freely [inferred]
_TALKATIVE = {Do.PING: 0, Do.READ: 1}  # the status return level that an answer needs, else 2


class Xl430:
    """A servo with its motor on a `screw`, switched on at a time `now` in seconds.

    `clock` is the rate of its own clock against ours; `tick` ms is where that clock begins.
    """

    def __init__(
        self,
        screw: Screw | None = None,
        *,
        identity: int = 1,
        now: float = 0.0,
        clock: float = 1.0,
        tick: int = 0,
    ) -> None:
        self.screw = Screw() if screw is None else screw
        self.table = ControlTable()
        self.table["id"] = identity
        self._clock = clock
        self._profile = Profile(now, self.screw.angle)
        self._switch_on(now, tick)
        self._silent_until = now

    @property
    def id(self) -> int:
        """Its address on the bus."""
        return self.table["id"]

    def _switch_on(self, now: float, tick: int = 0) -> None:
        """Registers of the RAM as they begin; the number of turns is lost."""
        self._profile = Profile(now, self._actual(now)[0])
        self._born, self._tick, self._heard = now, tick, now
        self._silent_until = now + _BOOT
        self._stalled_since: float | None = None
        self._registered: tuple[int, bytes] | None = None
        self._lose_turns(now)
        self.table.reset(eeprom=False)
        self.table["goal_pwm"] = self.table["pwm_limit"]
        self.table["goal_position"] = self._present(now)

    def _actual(self, now: float) -> tuple[float, float]:
        """Angle in ticks and speed in ticks/s of the screw, which hard ends may hold."""
        angle, speed = self._profile.at(now)
        low, high = self.screw.reach
        return (angle, speed) if low <= angle <= high else (min(max(angle, low), high), 0.0)

    def _lose_turns(self, now: float) -> None:
        """Count ticks from the turn that the screw is in."""
        self._turns = int(TICKS) * math.floor(self._actual(now)[0] / TICKS)

    def _present(self, now: float) -> int:
        return math.floor(self._actual(now)[0]) - self._turns + self.table["homing_offset"]

    def advance(self, now: float) -> float:
        """Let time pass; the carriage's travel in metres."""
        limit = 0.02 * self.table["bus_watchdog"]
        if self.table["torque_enable"] and 0.0 < limit < now - self._heard:
            self._bite(self._heard + limit)
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

    def _bite(self, now: float) -> None:
        """The watchdog: the bus was silent for too long."""
        self.table["bus_watchdog"] = -1
        # Older firmware takes another place for the goal if there is an offset, and runs away
        # (reported to DynamixelSDK in 2022); that it forgets the offset is [inferred].
        self.table["goal_position"] = self._present(now) - self.table["homing_offset"]
        self._profile = Profile(now, self._actual(now)[0])
        if self.table["homing_offset"]:
            self._aim(now)

    def fail(self, bits: int, now: float) -> None:
        """Raise hardware errors; those in the shutdown register take the torque away."""
        self.table["hardware_error"] |= bits
        if bits & self.table["shutdown"]:
            self.table["torque_enable"] = 0
            self._profile = Profile(now, self._actual(now)[0])

    def restart(self, now: float) -> None:
        """Lose power for a moment."""
        self._switch_on(now)

    def _aim(self, now: float) -> None:
        """Set out for the goal of the operating mode by the profile's registers."""
        table = self.table
        angle, speed = self._actual(now)
        mode, most = table["operating_mode"], SPEED_UNIT * table["velocity_limit"]
        cruise = SPEED_UNIT * table["profile_velocity"]
        acceleration = ACCELERATION_UNIT * table["profile_acceleration"] if cruise else 0.0
        if mode in (3, 4):
            goal = table["goal_position"] + 0.5 + self._turns - table["homing_offset"]
            self._profile = to(
                now, angle, speed, goal, speed=cruise or most, acceleration=acceleration
            )
            return
        share = table["goal_pwm"] / 885.0
        wanted = SPEED_UNIT * table["goal_velocity"] if mode == 1 else most * share
        self._profile = at_speed(now, angle, speed, wanted, acceleration=acceleration)

    def execute(self, instruction: int, parameters: bytes, now: float) -> Reply | None:
        """What the servo answers to an instruction at a time; None when it is silent."""
        self.advance(now)
        if now < self._silent_until:
            return None
        self._heard = now
        level = self.table["status_return"]
        error, data = self._executed(instruction, parameters, now)
        alert = ALERT if self.table["hardware_error"] else 0
        needs = next((n for do, n in _TALKATIVE.items() if do == instruction), 2)
        return (error | alert, data) if level >= needs else None

    def _executed(self, instruction: int, words: bytes, now: float) -> Reply:
        if instruction == Do.PING:
            model, firmware = self.table["model"], self.table["firmware"]
            return Fault.NONE, model.to_bytes(2, "little") + bytes([firmware])
        if instruction == Do.READ:
            return self._read(words, now)
        if instruction in (Do.WRITE, Do.REG_WRITE):
            return self._write(words, now, later=instruction == Do.REG_WRITE), b""
        if instruction == Do.ACTION:
            return self._act(now), b""
        if instruction == Do.CLEAR:
            return self._clear(words, now), b""
        if instruction in (Do.REBOOT, Do.FACTORY_RESET):
            return self._reset(instruction, words, now), b""
        return Fault.INSTRUCTION, b""

    def _read(self, words: bytes, now: float) -> Reply:
        if len(words) != 4:
            return Fault.LENGTH, b""
        self._refresh(now)
        address, size = (int.from_bytes(words[k : k + 2], "little") for k in (0, 2))
        data = self.table.read(address, size)
        return (Fault.ACCESS, b"") if data is None else (Fault.NONE, data)

    def _refresh(self, now: float) -> None:
        """Put what is true now into the registers that only tell."""
        table, (angle, speed) = self.table, self._actual(now)
        intended, _ = self._profile.at(now)
        units = round(speed / SPEED_UNIT)
        if abs(intended - angle) > _TOUCH:  # pressed against a hard end with all the PWM there is
            effort = math.copysign(1000 * table["goal_pwm"] // 885, intended - angle)
        else:
            effort = math.copysign(_FRICTION, speed) if speed else 0.0
        table["tick"] = (self._tick + int(1000.0 * self._clock * (now - self._born))) % TICK_WRAP
        table["moving"] = int(abs(units) > table["moving_threshold"])
        table["moving_status"] = 0x02 if speed else 0x01
        table["pwm"] = round(0.885 * effort)
        table["load"] = round(effort)
        table["velocity"] = table["velocity_trajectory"] = units
        table["position"] = table["position_trajectory"] = self._present(now)

    def _write(self, words: bytes, now: float, *, later: bool) -> Fault:
        if len(words) < 3:
            return Fault.LENGTH
        address, data = int.from_bytes(words[:2], "little"), words[2:]
        fault, changes = self.table.changes(address, data)
        if fault:
            return fault
        if later:
            self._registered = address, data
            self.table["registered"] = 1
            return Fault.NONE
        return self._apply(changes, now)

    def _apply(self, changes: list[Change], now: float) -> Fault:
        before = self.table["torque_enable"], self.table["operating_mode"]
        names = {register.name for register, _ in changes}
        fatal = self.table["hardware_error"] & self.table["shutdown"]
        if fatal and any(r.name == "torque_enable" and value for r, value in changes):
            return Fault.RESULT
        for register, value in changes:
            self.table[register.name] = value
        torque, mode = self.table["torque_enable"], self.table["operating_mode"]
        if mode == 3 != before[1]:
            self._lose_turns(now)
        if (torque, mode) != before or "homing_offset" in names:
            self._profile = Profile(now, self._actual(now)[0])
            self.table["goal_position"] = self._present(now)
        elif torque and GOALS[mode] in names:
            self._aim(now)
        return Fault.NONE

    def _act(self, now: float) -> Fault:
        if self._registered is None:
            return Fault.RESULT
        fault, changes = self.table.changes(*self._registered)
        self._registered = None
        self.table["registered"] = 0
        return fault or self._apply(changes, now)

    def _clear(self, words: bytes, now: float) -> Fault:
        if words != _CLEAR:
            return Fault.RANGE
        if self._actual(now)[1]:
            return Fault.RESULT  # only while it is still
        self._lose_turns(now)
        self._profile = Profile(now, self._actual(now)[0])
        self.table["goal_position"] = self._present(now)
        return Fault.NONE

    def _reset(self, instruction: int, words: bytes, now: float) -> Fault:
        if instruction == Do.FACTORY_RESET:
            kept = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud")}
            if words not in kept:
                return Fault.RANGE
            self.table.reset(keep=kept[words])
        self._switch_on(now)
        return Fault.NONE
