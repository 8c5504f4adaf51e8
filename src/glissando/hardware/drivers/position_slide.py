"""What stages share that are sent positions and report theirs: homing, moves and paths.

Goals lie inside the stroke and little ahead of the path. A position that the stage cannot have
reached is asked for again. Whatever ends a motion, the stage stands still.
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
_NEAR = 5e-4  # m from its goal where a move has arrived
_PACE = 0.02  # s between the readings of a move
_PATIENCE = 2.0  # s after a move should have ended


class StandingError(DeviceError):
    """The stage stands, or hears nothing any more: there is nothing to stop."""


class PositionSlide:
    """A stage that goes to positions of its own, to be used in a with-block.

    Args:
        stage: Its limits.

    Attributes:
        counts: How many answers were missing or corrupt.

    Raises:
        DeviceError: From any method: the device fails, or the travel is not known yet.
    """

    ahead = 3  # periods that a streamed goal is ahead of the path's now
    rate = 20.0  # Hz, of goals and readings
    least = 2e-6  # m: shorter steps are not sent

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
        """A time.monotonic(), s, and the device's own position then, m."""
        raise NotImplementedError

    def _home_place(self) -> float:
        """The device's position, m, where the travel is `home`, found by itself."""
        raise NotImplementedError

    def _aim(self, place: float, speed: float) -> None:
        """Have the device go to a position of its own, m, at a speed in m/s."""
        raise NotImplementedError

    def _stands(self, reading: SlideReading) -> bool:
        """Whether the device rests where it was read."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stand still at once."""
        raise NotImplementedError

    def abort(self) -> None:
        """End the motion that another thread waits for; that raises DeviceError there."""
        self._aborted = True

    def _forget(self) -> None:
        """The travel is not known any more."""
        self._zero = None

    def home_here(self, travel: float) -> None:
        """Declare the stage's travel now, in metres.

        Raises:
            DeviceError: No two answers of where it is agree: it moves, or answers are damaged.
        """
        self.stage.require_inside(travel)
        self._zero = self._standing_place() - self.stage.direction * travel
        self._last = None

    def _standing_place(self) -> float:
        """The device's own position, m, as two answers in turn agree on it."""
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
        """Find the travel by the device's own home, then enter the stroke."""
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
        """Where the stage is now; its speed is that since the reading before.

        Lines may be without a checksum: a position that the stage cannot have reached is asked for
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
        """A time before which the last reading was not measured."""
        return last.time

    def move(self, travel: float) -> list[SlideReading]:
        """Go to a travel in metres at the stage's speed."""
        speed = self.stage.speed
        self.stage.require_inside(travel)
        start = self.read()
        lasts = abs(travel - start.travel) / speed + speed / self.stage.acceleration
        with _standing_still(self):
            self._go(travel, speed, start.travel)
            return [start, *self._until_rest(travel, lasts)]

    def follow(self, time: ArrayLike, travel: ArrayLike) -> Iterator[SlideReading]:
        """Follow a path, straight between its points, yielding readings.

        Args:
            time: Times (K,), s; the first is now.
            travel: Travels (K,) at these times, m; the stage goes to the first before.
        """
        times, places = self.stage.path(time, travel)
        self.move(float(places[0]))
        yield from self.pursue(lambda t: np.interp(t, times, places), times[-1])

    def pursue(self, wanted: Callable[[float], float], lasts: float) -> Iterator[SlideReading]:
        """Follow a path that is decided on the way, yielding readings; at its end, rest.

        Args:
            wanted: The travel in m at a time in s from now, up to three periods after the end.
            lasts: Duration, s.
        """
        ahead = self.ahead / self.rate
        with _standing_still(self):
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
        """Aim at a travel, unless it is next to nothing; where the last goal is now, m."""
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


class _standing_still:  # noqa: N801
    """After any exception inside, the stage stands still."""

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
