"""Driver of the stage that slides the sensor: homing, moves, paths and readings.

Except in homing, nothing moves before the travel is known, and no goal lies outside the stroke.
During a motion the servo's own watchdog is on: it stops the motion if the host sends nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from time import monotonic, sleep
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import DeviceError
from glissando.hardware.drivers import dynamixel
from glissando.hardware.drivers.dynamixel import NoAnswerError, Servo
from glissando.hardware.drivers.homing import touch
from glissando.hardware.drivers.interfaces import SlideReading
from glissando.hardware.drivers.stage import Stage

_PACE = 0.01  # s between the readings of a move
_PATIENCE = 2.0  # s allowed beyond the expected duration of a move
_NEAR = 5e-4  # m from its goal at which a move is complete
_STILL = 8  # ticks by which two readings of a stage at rest may differ
_BOOT = 5.0  # s within which a servo must answer after a reboot
_AHEAD = 3  # periods by which a streamed goal leads the path


class Slide:
    """A stage with a servo, used as a context manager; at rest after the block.

    Every method raises DeviceError when the servo stops answering, refuses, switches off or loses
    its position.

    Args:
        address: Serial path.
        stage: The stage that the servo moves.

    Attributes:
        counts: Number of missing, corrupt or stale answers.
    """

    def __init__(self, address: str, stage: Stage) -> None:
        self.address, self.stage = address, stage
        self.counts: Counter[str] = Counter()
        self._open: Servo | None = None
        self._zero: float | None = None  # ticks at travel zero; None until home

    def __enter__(self) -> Self:
        self._open = Servo(self.address, self.stage.id, self.stage.baud)
        self.counts = self._servo.counts
        try:
            self._servo.prepare()
        except BaseException:
            self._servo.close()
            raise
        return self

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        self._zero = None
        try:
            self._servo.halt()
            if not self.stage.hold:
                self._servo.write(dynamixel.TORQUE, (0, 1), check_error=False)
        except DeviceError:
            if problem is None:  # otherwise the first error is more informative
                raise
        finally:
            self._servo.close()

    @property
    def _servo(self) -> Servo:
        if self._open is None:
            raise DeviceError("The slide is not open: use it as `with Slide(…) as slide:`.")
        return self._open

    @property
    def homed(self) -> bool:
        """Whether the stage's travel is known."""
        return self._zero is not None

    def home_here(self, travel: float) -> None:
        """Declare the present travel of the stage, m.

        Raises:
            DeviceError: Two successive positions differ: the stage moves, or answers are damaged.
        """
        self.stage.require_inside(travel)
        self._servo.power()
        places = [self._servo.state().position for _ in range(2)]
        if abs(places[1] - places[0]) > _STILL:
            raise DeviceError(
                f"The servo stood at {places[0]} and then at {places[1]} ticks; let the stage come "
                f"to rest, check the wiring, and home again."
            )
        self._zero = places[1] - self.stage.ticks(travel)

    def home_at_stop(self, *, speed: float = 0.004, pwm: float = 0.25) -> None:
        """Home by touching the mechanical stop twice, gently, then move into the stroke.

        Args:
            speed: Speed of approach, m/s.
            pwm: Fraction of the motor's voltage that it may use [inferred: enough to move, too
                little to harm or to overload; try it with a hand on the power switch].

        Raises:
            DeviceError: The stage has no stop, or it was not found.
        """
        home = self.stage.home
        if home is None:
            raise DeviceError(
                "The stage has no mechanical stop to home at; give its travel as `home`, or say "
                "where it is with home_here(travel)."
            )
        self.stage.require_speed(speed)
        self._zero = None
        self._servo.power()
        with self._moving(pwm):
            place = touch(self._servo, self.stage, speed, pwm)
        self._zero = place - self.stage.ticks(home)
        self.move(float(np.clip(home, *self.stage.stroke)), speed=speed)

    def read(self) -> SlideReading:
        """Present state of the stage."""
        zero = self._require_home()
        state, stage = self._servo.state(), self.stage
        return SlideReading(
            time=state.time,
            servo_time=state.clock,
            travel=stage.travel(state.position - zero),
            speed=stage.speed_of(state.velocity),
            load=1e-3 * stage.direction * state.load,
        )

    def move(
        self, travel: float, *, speed: float | None = None, acceleration: float | None = None
    ) -> list[SlideReading]:
        """Move to a travel with the servo's own trapezoidal speed profile.

        Args:
            travel: Goal, m.
            speed: Largest speed, m/s; that of the stage if None.
            acceleration: Acceleration of the profile, m/s²; that of the stage if None.

        Returns:
            The readings on the way.
        """
        self._require_home()
        stage = self.stage
        stage.require_inside(travel)
        speed = stage.speed if speed is None else speed
        acceleration = stage.acceleration if acceleration is None else acceleration
        stage.require_allowed(speed)
        stage.require_acceleration(acceleration)
        with self._moving():
            start = self.read()
            lasts = stage.lasting(travel - start.travel, speed, acceleration)
            units = stage.speed_units(speed), stage.acceleration_units(acceleration)
            self._aim(travel, *units)
            return [start, *self._until_rest(travel, lasts)]

    def follow(
        self, time: ArrayLike, travel: ArrayLike, *, rate: float = 50.0
    ) -> Iterator[SlideReading]:
        """Follow a piecewise linear path, and yield readings.

        The stage first moves to the first travel. Then `rate` times a second a goal slightly ahead
        on the path is sent, so that each goal is close. If the loop over the readings pauses for
        longer than the watchdog's time, the stage stops.

        Args:
            time: Times (K,), s; the first is the present.
            travel: Travels (K,) at these times, m.
            rate: Goals a second.

        Raises:
            DeviceError: The path leaves the stroke or is too fast, or the stage lags behind.
        """
        self._require_paced(rate)
        times, places = self.stage.path(time, travel)
        self.move(float(places[0]))
        yield from self.pursue(lambda t: np.interp(t, times, places), times[-1], rate=rate)

    def pursue(
        self, wanted: Callable[[float], float], lasts: float, *, rate: float = 50.0
    ) -> Iterator[SlideReading]:
        """Follow a function of time, and yield readings; at the end the stage stops.

        Args:
            wanted: Travel in m at a time in s from now, up to three periods after the end.
            lasts: Duration, s.
            rate: Goals a second.

        Raises:
            DeviceError: As for `follow`, raised when it occurs.
        """
        self._require_paced(rate)
        with self._moving():
            reading = self.read()
            begun = beat = monotonic()
            while (now := monotonic()) - begun < lasts:
                self._aim_ahead(wanted(now - begun + _AHEAD / rate), reading, now, _AHEAD / rate)
                reading = self.read()
                self._require_near(reading, wanted(reading.time - begun))
                yield reading
                beat = max(beat + 1.0 / rate, now)
                sleep(max(beat - monotonic(), 0.0))
            last = wanted(lasts)
            self._aim(last, self.stage.speed_units(self.stage.speed), 0)
            yield from self._until_rest(last, 0.0)

    def _aim_ahead(self, aim: float, last: SlideReading, now: float, ahead: float) -> None:
        """Send a goal slightly ahead on the path, at the speed that reaches it in time."""
        self.stage.require_inside(aim)
        position = last.travel + last.speed * (now - last.time)
        # Up to a tenth faster than the limit of a path, to catch up with it.
        speed = min(abs(aim - position) / ahead, 1.1 * self.stage.speed)
        self._aim(aim, self.stage.speed_units(speed), 0)

    def abort(self) -> None:
        """End the motion that another thread waits for, in which DeviceError is then raised."""
        if self._open is not None:
            self._open.aborted = True

    def stop(self) -> None:
        """Stop at once and hold the position; if that fails, switch the torque off."""
        if not self._servo.halt():
            self._zero = None

    def reboot(self) -> None:
        """Restart the servo, which clears hardware errors; home again afterwards."""
        self._zero = None
        self._servo.reboot()
        end = monotonic() + _BOOT
        while True:
            try:
                return self._servo.prepare()
            except DeviceError:
                if monotonic() > end:
                    raise

    def _require_home(self) -> float:
        if self._zero is None:
            raise DeviceError(
                "The stage does not know where it is: a servo forgets its turns when it is "
                "switched off. Home it first with home_here(travel) or home_at_stop()."
            )
        return self._zero

    def _require_paced(self, rate: float) -> None:
        self._require_home()
        if rate * self.stage.watchdog < 2.0:
            raise DeviceError(
                f"Goals at {rate:g} Hz are too few for a watchdog of {self.stage.watchdog:g} s; "
                f"give a rate of {2.0 / self.stage.watchdog:g} Hz or more."
            )

    def _require_near(self, reading: SlideReading, wanted: float) -> None:
        behind = abs(reading.travel - wanted)
        if behind > self.stage.lag:
            raise DeviceError(
                f"The stage is {1e3 * behind:.2g} mm off its path at {1e3 * wanted:.3g} mm (load "
                f"{100 * reading.load:.0f} %) and was stopped; free it, slow the path down, or "
                f"raise `lag`."
            )

    def _aim(self, travel: float, speed: int, acceleration: int) -> None:
        goal = round(self._require_home() + self.stage.ticks(travel))
        self._servo.aim(goal, speed=speed, acceleration=acceleration)

    def _until_rest(self, goal: float, lasts: float) -> Iterator[SlideReading]:
        begun = monotonic()
        while True:
            reading = self.read()
            yield reading
            over = monotonic() - begun - lasts
            if over > 0.0 and abs(reading.speed) <= abs(self.stage.speed_of(1.0)):
                break
            if over > _PATIENCE:
                raise DeviceError(
                    f"The stage still moves at {1e3 * reading.speed:.3g} mm/s, {over:.2g} s after "
                    f"it should have arrived; check its lead, {1e3 * self.stage.lead:g} mm."
                )
            sleep(_PACE)
        if abs(reading.travel - goal) > _NEAR:
            raise DeviceError(
                f"The stage stopped at {1e3 * reading.travel:.4g} mm instead of "
                f"{1e3 * goal:.4g} mm (load {100 * reading.load:.0f} %); free it and home again."
            )

    @contextmanager
    def _moving(self, pwm: float = 1.0) -> Iterator[None]:
        """Switch the watchdog on; stop the stage after any exception inside."""
        servo = self._servo
        if not servo.read(dynamixel.TORQUE, 1).data[0]:
            self._zero = None
            raise DeviceError(
                "The servo has lost its torque, and its position perhaps: it was restarted or "
                "moved by somebody else. Home again."
            )
        servo.write(dynamixel.WATCHDOG, (0, 1))
        most = servo.read(dynamixel.PWM_LIMIT, 2).signed(0, 2)
        servo.write(dynamixel.GOAL_PWM, (round(pwm * most), 2))
        servo.write(dynamixel.WATCHDOG, (round(self.stage.watchdog / 0.02), 1))
        try:
            yield
        except BaseException as problem:
            self._stop_after_error(problem)
            raise
        servo.write(dynamixel.WATCHDOG, (0, 1))

    def _stop_after_error(self, problem: BaseException) -> None:
        """Stop after an exception; raise a more informative error if the watchdog stopped first."""
        servo = self._servo
        if isinstance(problem, NoAnswerError):  # it may still receive: write only
            self._zero = None
            with suppress(DeviceError):
                servo.write(dynamixel.TORQUE, (0, 1), check_error=False)
            return
        stopped = isinstance(problem, DeviceError) and servo.watchdog_stopped()
        with suppress(DeviceError):
            self.stop()
        if stopped:
            raise DeviceError(
                f"The servo heard nothing for {self.stage.watchdog:g} s while it moved and "
                f"stopped; take readings faster, or raise `watchdog`."
            ) from problem
