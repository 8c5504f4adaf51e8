"""Base class of stages that accept and report positions: homing, moves and paths.

Goals lie inside the stroke and slightly ahead of the path. A position that the stage cannot have
reached is requested again. However a motion ends, the stage stops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from time import monotonic, sleep
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import DeviceError
from glissando.hardware.drivers.interfaces import SlideReading
from glissando.hardware.drivers.position_stage import PositionStage

_MM = 1e3
_ATTEMPTS = 4
_NEAR = 5e-4  # m from its goal at which a move is complete
_PACE = 0.02  # s between the readings of a move
_PATIENCE = 2.0  # s allowed beyond the expected duration of a move


class StandingError(DeviceError):
    """The stage is already at rest, or no longer receives commands: no stop is needed."""


class PositionSlide:
    """A stage commanded in positions of its device's own frame, used as a context manager.

    Args:
        stage: Limits of the stage.

    Attributes:
        counts: Number of missing or corrupt answers.

    Raises:
        DeviceError: From any method: the device fails, or the travel is not yet known.
    """

    ahead = 3  # periods by which a streamed goal leads the path
    rate = 20.0  # Hz, of goals and readings
    least = 2e-6  # m, shortest step that is sent

    def __init__(self, stage: PositionStage) -> None:
        self.stage = stage
        self.counts: Counter[str] = Counter()
        self._zero: float | None = None  # the device's position at travel zero, m
        self._last: SlideReading | None = None
        self._aborted = False

    def __enter__(self) -> Self:
        raise NotImplementedError

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        try:
            self.stop()
        except DeviceError:
            if problem is None:
                raise
        finally:
            self._close()

    def _close(self) -> None:
        """Close the device."""
        raise NotImplementedError

    def _place(self) -> tuple[float, float]:
        """A time.monotonic(), s, and the device's own position at that time, m."""
        raise NotImplementedError

    def _home_place(self) -> float:
        """Home the device, and return its own position, m, at which the travel is `home`."""
        raise NotImplementedError

    def _aim(self, place: float, speed: float) -> None:
        """Command the device to go to its own position `place`, m, at a speed in m/s."""
        raise NotImplementedError

    def _stands(self, reading: SlideReading) -> bool:
        """Whether the device is at rest at a reading."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stop at once."""
        raise NotImplementedError

    def abort(self) -> None:
        """End the motion that another thread waits for, in which DeviceError is then raised."""
        self._aborted = True

    def _forget(self) -> None:
        """Mark the travel as unknown."""
        self._zero = None

    def home_here(self, travel: float) -> None:
        """Declare the present travel of the stage, m.

        Raises:
            DeviceError: Successive positions disagree: the stage moves, or answers are damaged.
        """
        self.stage.require_inside(travel)
        self._zero = self._standing_place() - self.stage.direction * travel
        self._last = None

    def _standing_place(self) -> float:
        """Own position of the device at rest, m, confirmed by two successive answers."""
        now = self._place()[1]
        for _ in range(_ATTEMPTS):
            before, now = now, self._place()[1]
            if abs(now - before) <= _NEAR:
                return now
            self.counts["corrupt"] += 1
        raise DeviceError(
            f"The stage stood at {_MM * before:.4g} mm and then at {_MM * now:.4g} mm of its own; "
            f"let it come to rest, check the line, and home again."
        )

    def home_at_stop(self) -> None:
        """Home the device, then move into the stroke."""
        if self.stage.home is None:
            raise DeviceError(
                "The stage has no home of its own; give its travel there as `home`, or say where "
                "it is with home_here(travel)."
            )
        self._forget()
        self._last = None
        self._zero = self._home_place() - self.stage.direction * self.stage.home
        self.move(float(np.clip(self.read().travel, *self.stage.stroke)))

    def read(self) -> SlideReading:
        """Present state of the stage; its speed is the mean since the last reading.

        Answers may lack a checksum: a position that the stage cannot have reached is requested
        again.
        """
        if self._aborted:
            raise DeviceError("The motion of the stage was aborted.")
        for _ in range(_ATTEMPTS):
            reading = self._read()
            if self._last is None or self._reachable(self._last, reading):
                self._last = reading
                return reading
            self.counts["corrupt"] += 1
        self._forget()
        raise DeviceError(
            f"The stage is at {_MM * reading.travel:.4g} mm, where it cannot have gone since the "
            f"last reading; somebody else moves it, or the line is disturbed. Home again."
        )

    def _read(self) -> SlideReading:
        zero = self._require_home()
        time, place = self._place()
        travel = self.stage.direction * (place - zero)
        last, speed = self._last, 0.0
        if last is not None and 0.0 < time - last.time < 1.0:
            speed = (travel - last.travel) / (time - last.time)
        return SlideReading(time, time, travel, speed, 0.0)

    def _reachable(self, last: SlideReading, now: SlideReading) -> bool:
        way = abs(now.travel - last.travel)
        return way <= 1.5 * self.stage.speed * (now.time - self._measured_after(last)) + _NEAR

    def _measured_after(self, last: SlideReading) -> float:
        """Time before which the last reading cannot have been measured."""
        return last.time

    def move(self, travel: float) -> list[SlideReading]:
        """Go to a travel in metres at the stage's speed."""
        speed = self.stage.speed
        self.stage.require_inside(travel)
        start = self.read()
        lasts = abs(travel - start.travel) / speed + speed / self.stage.acceleration
        with _stop_on_error(self):
            self._go(travel, speed, start.travel)
            return [start, *self._until_rest(travel, lasts)]

    def follow(self, time: ArrayLike, travel: ArrayLike) -> Iterator[SlideReading]:
        """Follow a piecewise linear path, and yield readings.

        Args:
            time: Times (K,), s; the first is the present.
            travel: Travels (K,) at these times, m; the stage first moves to the first of them.
        """
        times, places = self.stage.path(time, travel)
        self.move(float(places[0]))
        yield from self.pursue(lambda t: np.interp(t, times, places), times[-1])

    def pursue(self, wanted: Callable[[float], float], lasts: float) -> Iterator[SlideReading]:
        """Follow a function of time, and yield readings; at the end the stage stops.

        Args:
            wanted: Travel in m at a time in s from now, up to `ahead` periods after the end.
            lasts: Duration, s.
        """
        ahead = self.ahead / self.rate
        with _stop_on_error(self):
            aim = self.read().travel
            begun = beat = until = monotonic()  # until: when the goals that wait are reached
            while (now := monotonic()) - begun < lasts:
                goal = float(wanted(now - begun + ahead))
                self.stage.require_inside(goal)
                span = now + ahead - max(until, now)
                speed = min(abs(goal - aim) / span, 1.1 * self.stage.speed)
                aim, until = self._go(goal, speed, aim), now + ahead
                reading = self.read()
                self._require_near(reading, float(wanted(reading.time - begun)))
                yield reading
                beat = max(beat + 1.0 / self.rate, now)
                sleep(max(beat - monotonic(), 0.0))
            last = float(wanted(lasts))
            self._go(last, self.stage.speed, aim)
            yield from self._until_rest(last, 0.5)

    def _go(self, travel: float, speed: float, since: float) -> float:
        """Send a goal unless it is within `least` of the last; returns the goal in effect, m."""
        if abs(travel - since) < self.least:
            return since
        self._aim(self._require_home() + self.stage.direction * travel, speed)
        return travel

    def _until_rest(self, goal: float, lasts: float) -> Iterator[SlideReading]:
        begun = monotonic()
        while True:
            reading = self.read()
            yield reading
            if abs(reading.travel - goal) < _NEAR and self._stands(reading):
                return
            if monotonic() - begun > lasts + _PATIENCE:
                raise DeviceError(
                    f"The stage is at {_MM * reading.travel:.4g} mm instead of {_MM * goal:.4g} "
                    f"mm; free it, check its steps per mm or its unit, and home again."
                )
            sleep(_PACE)

    def _require_near(self, reading: SlideReading, wanted: float) -> None:
        behind = abs(reading.travel - wanted)
        if behind > self.stage.lag:
            raise DeviceError(
                f"The stage is {_MM * behind:.2g} mm off its path at {_MM * wanted:.3g} mm and "
                f"was stopped; slow the path down, raise the controller's acceleration, or `lag`."
            )

    def _require_home(self) -> float:
        if self._zero is None:
            raise DeviceError(
                "The stage does not know where it is. Home it first with home_here(travel) or "
                "home_at_stop()."
            )
        return self._zero


class _stop_on_error:  # noqa: N801
    """Context that stops the stage after any exception inside."""

    def __init__(self, slide: PositionSlide) -> None:
        self._slide = slide

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        if problem is not None and not isinstance(problem, StandingError):
            try:
                self._slide.stop()
            except DeviceError:
                if isinstance(problem, GeneratorExit):
                    raise
