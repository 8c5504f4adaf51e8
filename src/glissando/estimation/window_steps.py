"""A sliding window on its way: node after node with what was read, through pauses and restarts.

While nothing was read there is but one node, at rest. In a pause nodes lie closer than the times
asked for, and belief grows until a robot at rest is known as well; from then on it stays that.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from itertools import pairwise

import numpy as np

from glissando._kernels.threads import one_thread
from glissando.errors import OutsideGridError, UnobservableError
from glissando.estimation.gated_update import GatedUpdate
from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.innovation_gate import InnovationGate
from glissando.estimation.misfit import breakdown, unreachable_readings
from glissando.estimation.reading_buffer import ReadingBuffer
from glissando.estimation.reading_pause import ReadingPause
from glissando.estimation.shape_spread import ShapeSpread, shape_covariances, tip_spread
from glissando.estimation.sliding_window import SlidingWindow
from glissando.estimation.state_estimate import StateEstimate
from glissando.estimation.window_parameters import NotLinearError
from glissando.model.grid import Grid
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings

_MERGED = 0.01  # of the longest interval: a node as close to the newest one would be singular
_BACK = 2.0  # s before the oldest node: a clock that was set, not a reading that came late
_ROUNDED = 5e-4  # of the least step, by which times round: less than the prior allows it
_MOST = 50  # nodes of a window that reaches back further than its lag
_BREAKDOWNS = (np.linalg.LinAlgError, UnobservableError, NotLinearError)  # of a solution
_CLOSEST = 0.2  # of the last interval: no node is put nearer to the newest one to look ahead


class WindowSteps:
    """Steps of a window of `lag` time nodes, with readings that a gate of a chance believes.

    Attributes:
        window: The window.
        lag: How many time nodes it keeps, or more where they are to reach back further.
        reach: How far back they do at least, s.
        gate: What judges readings.
        buffer: The readings of the window, and those still to come.
        update: Solutions of the window with new readings.
        updates: How many there were.
        restarts: How often it began again from rest.
    """

    def __init__(self, window: SlidingWindow, lag: int, gate: float | None) -> None:
        self.window, self.lag, self.reach = window, lag, 0.0
        self.gate = InnovationGate(gate)
        self.buffer = ReadingBuffer(float(window.arclength[-1]), self.gate, window.takes_as_row)
        self.update = GatedUpdate(window, self.buffer, self.gate)
        self.updates = self.restarts = 0
        self._least = (1.0 + _ROUNDED) * window.prior.least_step(window.arclength)
        self._asked = -np.inf
        self._started = self._explained = False
        self._oldest, self._pause = -np.inf, ReadingPause()

    @property
    def time(self) -> float | None:
        """Time of the newest node, None before the first."""
        return float(self.window.nodes.time[-1]) if self.window.started else None

    def take(self, readings: Readings) -> None:
        """Take readings of one stream, unless they came before or lie before the window."""
        self.buffer.take(readings, self._oldest)

    def advance(self, time: float) -> None:
        """Go on to a time with all readings up to then.

        Raises:
            OutsideGridError: The time lies seconds before all that is estimated.
        """
        self._asked, time = time, self._new_time(time)
        with one_thread():
            self.buffer.refuse_ahead(max(time, self.time or time))
            while self._step(self._next_node(time)) < time:
                pass

    @property
    def behind(self) -> bool:
        """Whether the newest node is older than what was asked for, as nodes would be too close."""
        newest = self.time
        return newest is not None and self._asked - newest > _MERGED * self._pause.step

    def ahead(self, time: float) -> SlidingWindow:
        """The window, or where a time is ahead of it a copy with more nodes.

        Those lie as they would if nothing were read until then, as far as where a robot at rest is
        known as well: the copy has one node there, of that, which holds from then on.
        """
        window, nodes = self.window, self.window.nodes.time
        newest = float(nodes[-1])
        if time <= newest or self.resting:
            return window
        window = window.copied()
        before = window.before if len(nodes) == 1 else nodes[-2]
        # Nodes may be too close; one further ahead than asked for does not change the answer.
        least = 0.0 if before is None else _CLOSEST * float(newest - before)
        time = max(time, newest + max(least, self._least))
        with one_thread():
            while newest < time:
                newest = self._pause.next_in_void(newest, time)
                window.append(newest)
                first = max(0, len(window.nodes) - 2)
                window.solve(first, self.buffer.since(window.since(first)))
                if newest < time and self._pause.is_at_rest(self._spread(window), newest):
                    _begin_at_rest(window, newest)
                    break
        return window

    def _new_time(self, time: float) -> float:
        """The time, or the newest node's where a node at it would be too close to that."""
        if not self.window.started:
            return time
        nodes, before = self.window.nodes.time, self.window.before
        if time < nodes[0] - _BACK:
            raise OutsideGridError(
                f"Time went back from {seconds(nodes[-1], time, decimals=6)} s; the clock was set. "
                f"Begin anew with another smoother, and give times of a monotonic clock."
            )
        on = [*([] if before is None else [before]), *nodes.tolist()]
        longest = max((b - a for a, b in pairwise(on)), default=0.0)
        close = _MERGED * min(longest, self._pause.step)  # however long a pause lasted
        close = max(close, self._least)
        return on[-1] if time - on[-1] < close else time

    def _next_node(self, time: float) -> float:
        """The next node on the way to a time: that time, but in a pause nodes lie closer."""
        newest = self.time
        if newest is None or self.resting:
            return time
        stop = self._pause.next_node(newest, time, self.buffer)
        return stop if time - stop >= self._least else time

    def _step(self, time: float) -> float:
        """One node more, or none if the time is not new, with what came; the newest time."""
        before = self.time
        self._append(time)  # the prior's mean leads there (2')
        newest = float(self.window.nodes.time[-1])
        fresh, earliest = self._arrive()
        if fresh or before is None or newest > before:
            starts = bool(fresh) and not self._started
            if starts:
                self._started = self.update.start(fresh)  # all there is, as in a batch
            try:
                self._solve(self.update.first_changed(earliest), fresh)  # (19) to (21), gated
                self.window.settle()
                self._explained |= fresh.total() > 0
            except _BREAKDOWNS as error:
                since = min(earliest, newest - self._pause.step)
                self._recover(error, since, fresh, restart=self._started and not starts)
                with suppress(NotLinearError):
                    self.window.settle()
            if fresh.total():
                curved = self._pause.curved
                self._pause.end(before, newest)
                if curved:  # what was read may be elsewhere
                    self._pause.note(self._spread(self.window))
            elif self._started:
                self._note_pause(newest)
            self._marginalize()  # the Schur complement of what leaves (20)
            self.updates += 1
        return newest

    def _append(self, time: float) -> None:
        """A node at a time after the newest; while nothing was read there is but one, at rest."""
        window = self.window
        if window.started and time <= window.nodes.time[-1]:
            return
        if window.started and not self.resting:
            window.append(time)
            return
        begin, pause = time, self._pause
        if window.started:
            pause.step = min(pause.step, time - float(window.nodes.time[-1]))
            due = self.buffer.due(time)
            if due.size:
                begin = max(self._oldest, min(float(due[0]), time - pause.step))
                begin = min(begin, time - self._least)
        else:
            self._oldest = time
        self._rest(begin)
        if begin < time:
            window.append(time)

    def _rest(self, time: float) -> None:
        """A single node at rest."""
        window = self.window
        window.lone = self._pause.lone
        self._started = False
        self._pause.begin_at_rest()
        first = window.prior.fixes_base and not self._pause.has_rest
        _begin_at_rest(window, time, solve=first)
        if first:
            self._pause.set_rest(self._spread(window), float(window.arclength[-1]))

    @staticmethod
    def _spread(window: SlidingWindow) -> tuple[float, float]:
        """RMS displacement (m) and swing (rad) of the newest tip."""
        return tip_spread(*window.newest())

    @property
    def resting(self) -> bool:
        """Whether nothing is known but the prior."""
        return not self._started and self._pause.has_rest

    @property
    def read(self) -> bool:
        """Whether readings lie in the last interval."""
        window = self.window
        held = self.buffer.since(window.since(len(window.nodes) - 1))
        return bool(held.streams or held.which.size)

    def _note_pause(self, newest: float) -> None:
        """Begin again where the newest state is no better known than that of a robot at rest."""
        spread = self._spread(self.window)
        self._pause.note(spread)
        if self._pause.is_at_rest(spread, newest):
            self._restart(newest, Counter())

    @property
    def curved(self) -> bool:
        """Whether belief is so wide that the spread of shapes counts, as after a pause."""
        return self._pause.curved or self.resting

    def newest(self) -> StateEstimate:
        """The newest state; after a pause with the spread of shapes."""
        linear = self.window.newest_nodes()
        if not self.curved:
            return linear
        cov = shape_covariances(self.window.arclength, *self.window.newest())
        return ShapeSpread(linear.pose, linear.strain, linear.velocity, cov)

    def _arrive(self) -> tuple[Counter[str], float]:
        """New readings up to the newest node: how many of each stream, and the earliest's time."""
        time = self.window.nodes.time
        return self.buffer.arrive(float(time[0]), float(time[-1]))

    def _marginalize(self) -> None:
        """Let nodes and readings go that are older than the lag and beyond reach."""
        while len(self.window.nodes) > self.lag and not self._is_in_reach:
            self.window.drop()
        if not self.resting:
            self._oldest = float(self.window.nodes.time[0])
        self.buffer.forget(min(self._oldest, self.window.since(0)))

    @property
    def _is_in_reach(self) -> bool:
        """Whether the oldest node is needed to reach back."""
        time = self.window.nodes.time
        return bool(time[-1] - time[1] < self.reach) and time.size <= _MOST

    def _restart(self, since: float, fresh: Counter[str]) -> None:
        """Begin again from rest, where states have become absurd or say nothing more."""
        self.restarts += 1
        newest = float(self.window.nodes.time[-1])
        self._begin_again(max(since, self._oldest) if fresh else newest, fresh)

    def _begin_again(self, oldest: float, fresh: Counter[str]) -> None:
        """A robot at rest at a time, and from there to the newest node what was read."""
        newest = float(self.window.nodes.time[-1])
        self._oldest = oldest
        self._rest(oldest)
        self.buffer.forget(oldest)
        if oldest < newest:
            self.window.append(newest)
        if fresh:
            self._started = self.update.start(fresh)
        self._solve(0, fresh)

    def _recover(
        self, error: Exception, since: float, fresh: Counter[str], *, restart: bool
    ) -> None:
        """Begin again from rest with what was read since, or without what no shape explains.

        Only a robot whose base nothing fixes has no rest to return to: its error is raised. So is
        that readings are far beyond reach, as in another unit, if never yet were any explained.
        """
        newest = float(self.window.nodes.time[-1])
        try:
            if not restart:
                raise error
            self._restart(since, fresh)
        except _BREAKDOWNS as again:
            prior, grid = self.window.prior, self.window.grid()
            streams = self.buffer.streams(-np.inf)
            far = None if self._explained else unreachable_readings(grid, prior, streams)
            if prior.fixes_base:
                self.update.refuse(fresh)
                self._begin_again(newest, fresh)
            if far or not prior.fixes_base:
                raise breakdown(again, grid, prior, streams) from again

    def _solve(self, first: int, fresh: Counter[str]) -> None:
        """Solve from a node on, with the new readings that the gate believes."""
        self.update.update(first, fresh, linear=not self._pause.curved)


def _begin_at_rest(window: SlidingWindow, time: float, *, solve: bool = True) -> None:
    """Begin a window with a node of a robot at rest."""
    window.begin(time, window.prior.rest_state(Grid(window.arclength, [time])).take(0))
    if solve:
        window.solve(0, HeldReadings())
