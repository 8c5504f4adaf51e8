"""Live estimation: readings in, and at a steady rate the current shape with its covariance out."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np

from glissando.errors import DeviceError, GlissandoError, ImplausibleError, UnreachableError
from glissando.estimation.fixed_lag import FixedLagSmoother
from glissando.hardware.live.clock import SessionClock
from glissando.hardware.live.sinks import Sink
from glissando.hardware.live.sources import Source
from glissando.hardware.live.update import Update
from glissando.io.journal import Journal
from glissando.model.grid import Grid
from glissando.model.robot import Robot
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import PoseReadings

_LOOK = 0.005  # s between checks for the first reading
_POLL = 0.02  # s between polls of the sources while an update is awaited
_OFF = 1.0  # s by which a source's newest reading may deviate from this computer's clock
_AHEAD = 0.05  # s by which a reading may be ahead of the clock and still count as current
_MOST_NODES = 1000
_NODES = 4  # time nodes in the smoother's window by default


class LiveSession:
    """A live estimate, used as a context manager and iterated for its updates.

    The first update is at the time of the earliest reading; the others follow at `rate`. Every
    reading is written to the journal before it is used. If the machine is too slow, updates are
    skipped and counted, so that the latency does not grow.

    Args:
        robot: The robot with its prior, grid and sensor parameters.
        sources: Sources of readings.
        sinks: Receivers of the updates.
        rate: Updates a second; the robot's `time_rate` if None.
        lag: Length of the smoother's window, s; four time nodes if None, a filter if 0.
        delay: Seconds from the time of an update to its computation, in which readings of that
            time can still arrive; the next update uses those that arrive later.
        points: Number of points along the robot at which the shape is evaluated.
        journal: New folder of a recording to which all readings are written; no journal if None.
        duration: Seconds after which the session ends; if None, it ends when all sources have.
        patience: Seconds without a current reading after which the session ends with an error; the
            time in which a source is `busy` does not count.
        clock: Session clock; if None, that of a source which has one, else a new one.

    Attributes:
        waiting: Called repeatedly with the reason for the silence until a first reading arrives.

    Raises:
        GlissandoError: An argument is invalid; or, during the session, a source or sink failed.
        ImplausibleError: A source's first readings are far from the present: the clocks differ.

        with LiveSession(robot, [IgtlSource("igtl://127.0.0.1", robot, places)]) as session:
            for update in session:
                print(update.time, update.tip, update.std_tip)
    """

    def __init__(
        self,
        robot: Robot,
        sources: Sequence[Source],
        sinks: Sequence[Sink] = (),
        *,
        rate: float | None = None,
        lag: float | None = None,
        delay: float = 0.0,
        points: int = 30,
        journal: Path | None = None,
        duration: float | None = None,
        patience: float = 20.0,
        clock: SessionClock | None = None,
    ) -> None:
        rate = robot.time_rate if rate is None else rate
        _require(rate, lag or 0.0, delay, points, duration, patience)
        nodes = _NODES if lag is None else round(lag * rate) + 1
        if not sources:
            raise GlissandoError("A live estimate needs a source of readings; give one.")
        self.robot, self.sources, self.sinks = robot, tuple(sources), tuple(sinks)
        self.rate, self.delay, self.duration, self.patience = rate, delay, duration, patience
        self.clock, self._clock_given = clock or SessionClock(), clock is not None
        self.arclength = np.linspace(0.0, robot.length, points)
        self.skipped, self.journal_folder = 0, journal
        self._journal: Journal | None = None
        self._stack = ExitStack()
        self.smoother = FixedLagSmoother(
            robot.prior, robot.arclength_nodes, window=nodes,
            sensor_parameters=robot.sensor_parameters,
        )  # fmt: skip
        self._last_current = 0.0
        self._current_sources: set[str] = set()
        self._clock_problems: dict[str, str] = {}  # by source, the error of its stamps
        self._lag = self.smoother.lag / rate
        self.waiting: Callable[[str], None] | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            if self.journal_folder is not None:
                journal = Journal(self.journal_folder, self.journal_folder.name, self.robot)
                self._journal = stack.enter_context(journal)
                if journal.streams:
                    raise GlissandoError(
                        f"{self.journal_folder} holds the readings of an earlier session; give the "
                        f"journal a new folder."
                    )
            _warm_up(self.robot, self.rate)
            for sink in self.sinks:
                stack.enter_context(sink)
            for source in self.sources:
                stack.enter_context(source)
                if source.clock is not None and not self._clock_given:
                    self.clock = source.clock
            gc.collect()
            gc.freeze()  # a collection of all that is there would hold an update up by 70 ms
            stack.callback(gc.unfreeze)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[Update]:
        """Yield updates until the duration has passed or all sources have finished."""
        begins = [s.first for s in self.sources if s.first is not None]
        if begins:
            self.clock.begin_at(min(begins))
        self._last_current = time.monotonic()
        while not (arrived := self._read()):
            if self._finished():
                return
            self._require_readings()
            if self.waiting is not None:
                self.waiting(self._why_silent)
            time.sleep(_LOOK)
        first = min(float(r.time.min()) for r in arrived)
        number = skip = 0
        while self.duration is None or number + skip <= round(self.duration * self.rate):
            due = first + (number + skip) / self.rate
            self._wait_until(due + self.delay)
            late = int((self.clock.now() - self.delay - due) * self.rate)
            if late > 1:  # one is made up for by the next update
                skip, self.skipped = skip + late, self.skipped + late
                continue
            finished = self._finished()
            arrived += self._read()
            if not finished:
                self._require_readings()
            yield self._update(number, due, arrived)
            if finished:
                return
            arrived, number = [], number + 1

    def _read(self) -> list[Readings]:
        """Read all sources into the journal and the smoother, after polling the sinks."""
        for sink in self.sinks:
            sink.poll()
        arrived: list[Readings] = []
        for source in self.sources:
            new = source.read(self.clock)
            for readings in new:
                if self._journal is not None:
                    self._journal.write(readings)
                self.smoother.add(readings)
            if new:
                self._check_stamps(source, max(float(readings.time.max()) for readings in new))
            arrived += new
        return arrived

    def _check_stamps(self, source: Source, newest: float) -> None:
        """Record that a source sent current readings; raise if its first readings are far off."""
        now = self.clock.now()  # -inf before simulated time has begun
        off = newest - now if now > -np.inf else 0.0
        if -(self.delay + self._lag) <= off <= _AHEAD:
            self._last_current = time.monotonic()
            self._current_sources.add(source.name)
            self._clock_problems.pop(source.name, None)
            return
        side = "ahead of" if off > 0.0 else "behind"
        off_by = f"{source.name}: its readings are stamped {abs(off):.3g} s {side} this computer's"
        if abs(off) <= _OFF + self.delay:
            if off > 0.0:
                self._last_current = time.monotonic()
                what = "clock, so the shape is of another moment"
            else:
                what = f"clock, before the window of {self._lag:.3g} s: none is used; give a delay"
            self._clock_problems[source.name] = f"{off_by} {what}"
            return
        self._clock_problems[source.name] = f"{off_by} clock"
        if source.name not in self._current_sources:
            raise ImplausibleError(
                f"{off_by} clock; set both by NTP, or take readings by their arrival "
                f"(clock=arrival)."
            )

    def _wait_until(self, due: float) -> None:
        """Wait until a session time while polling the sources."""
        while -np.inf < (now := self.clock.now()) < due - _POLL:
            self.clock.sleep_until(now + _POLL)
            for source in self.sources:
                source.poll()
        self.clock.sleep_until(due)

    def _update(self, number: int, due: float, arrived: list[Readings]) -> Update:
        began = time.perf_counter()
        problems = [s.problem for s in self.sources] + [s.problem for s in self.sinks]
        problems += self._clock_problems.values()
        try:
            newest = self.smoother.advance(due)
        except UnreachableError as problem:  # readings in another unit: the estimate is at rest
            newest = self.smoother.newest()
            problems.append(str(problem))
        computing, shape = time.perf_counter() - began, self.smoother.at(self.arclength, due)
        ready = self.clock.now()
        update = Update(
            number, due, self.clock.stamp(due), self.arclength, shape, newest, arrived,
            self.smoother, ready, ready - self.delay - due, computing, self.skipped,
            tuple(filter(None, problems)),
        )  # fmt: skip
        for sink in self.sinks:
            sink.send(update)
        return update

    def _finished(self) -> bool:
        return all(source.finished for source in self.sources)

    def _require_readings(self) -> None:
        if any(getattr(source, "busy", False) for source in self.sources):
            self._last_current = time.monotonic()
        silent = time.monotonic() - self._last_current
        if silent > self.patience:
            raise DeviceError(
                f"No source has sent anything usable for {silent:.0f} s ({self._why_silent}); "
                f"check that the senders run, and where their devices sit on the robot."
            )

    @property
    def _why_silent(self) -> str:
        problems = [*self._clock_problems.values(), *(source.problem for source in self.sources)]
        return "; ".join(filter(None, problems)) or "no reading came"


def _warm_up(robot: Robot, rate: float) -> None:
    """Load the compiled kernels with a robot at rest, so that the first updates are not late."""
    smoother = FixedLagSmoother(robot.prior, robot.arclength_nodes)
    rest = robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0])).take(0).pose[[0, -1]]
    for number in range(3):
        time = np.full(2, number / rate)
        ends = robot.arclength_nodes[[0, -1]]
        smoother.add(PoseReadings(time=time, arclength=ends, values=rest, cov=np.array(1e-6)))
        smoother.advance(number / rate)
        smoother.at(ends, number / rate)


def _require(
    rate: float, lag: float, delay: float, points: int, duration: float | None, patience: float
) -> None:
    """Raise GlissandoError for an argument out of range."""
    if not 0.1 <= rate <= 1000.0:
        raise GlissandoError(f"A rate of {rate:g} Hz cannot be; give 0.1 to 1000.")
    if not 0.0 <= lag * rate <= _MOST_NODES:
        most = _MOST_NODES / rate
        raise GlissandoError(
            f"A lag of {lag:g} s cannot be; give seconds, 0 to {most:g} at {rate:g} Hz."
        )
    if not 0.0 <= delay <= 10.0:
        raise GlissandoError(f"A delay of {delay:g} s cannot be; give seconds, 0 to 10.")
    if not 2 <= points <= 1000:
        raise GlissandoError(f"{points} points along the robot cannot be; give 2 to 1000.")
    if not (duration is None or 0.0 < duration < np.inf) or not patience > 0.0:
        raise GlissandoError(
            "A duration and a patience are seconds above zero; correct them, or leave the duration "
            "out for a session that lasts as long as its sources."
        )
