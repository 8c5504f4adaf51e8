"""Steps of a sliding window: node after node with new readings, through pauses and restarts.

Before the first reading there is only one node, at rest. In a pause nodes lie closer than the
requested times, and the covariance grows until it reaches that of a robot at rest; then the window
returns to one node at rest.
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
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.seconds import seconds
from glissando.model.sensors.readings import Readings

_MERGED = 0.01  # share of the longest interval: a node this close to the newest would be singular
_BACK = 2.0  # s before the oldest node: a clock was set back, which is not a late reading
_ROUNDED = 5e-4  # share of the least step by which times may be rounded
_MOST = 50  # most nodes of a window that reaches back farther than its lag
_BREAKDOWNS = (np.linalg.LinAlgError, UnobservableError, NotLinearError)  # of a solution
_CLOSEST = 0.2  # share of the last interval: least distance of a predicted node from the newest


class WindowSteps:
    """Advances a window of `lag` time nodes, with readings gated by the probability `gate`.

    Attributes:
        window: The window.
        lag: Number of time nodes to keep, or more where they must reach back farther.
        reach: Least time that the nodes reach back, s.
        gate: Innovation gate of the readings.
        buffer: Readings of the window, and those that wait.
        update: Solver of the window with new readings.
        updates: Number of updates.
        restarts: Number of restarts from rest.
    """

    def __init__(self, window: SlidingWindow, lag: int, gate: float | None) -> None:
        self.window, self.lag, self.reach = window, lag, 0.0
        self.gate = InnovationGate(gate)
        self.buffer = ReadingBuffer(float(window.arclength[-1]), self.gate, window.takes_as_row)
        self.update = GatedUpdate(window, self.buffer, self.gate)
        self.updates = self.restarts = 0
        self._least = (1.0 + _ROUNDED) * window.prior.least_step(window.arclength)
        self._requested = -np.inf
        self._started = self._explained = False
        self._oldest, self._pause = -np.inf, ReadingPause()
        self._cov_at_rest: Array | None = None  # of the newest nodes, as it stays the same

    @property
    def time(self) -> float | None:
        """Time of the newest node, None before the first."""
        return float(self.window.nodes.time[-1]) if self.window.started else None

    def take(self, readings: Readings) -> None:
        """Buffer readings of one stream, unless they are repeated or lie before the window."""
        self.buffer.take(readings, self._oldest)

    def advance(self, time: float) -> None:
        """Advance to a time with all readings up to it.

        Raises:
            OutsideGridError: The time lies seconds before the window.
        """
        self._requested, time = time, self._new_time(time)
        with one_thread():
            self.buffer.refuse_ahead(max(time, self.time or time))
            while self._step(self._next_node(time)) < time:
                pass

    @property
    def behind(self) -> bool:
        """Whether the newest node is older than the requested time, as nodes were too close."""
        newest = self.time
        return newest is not None and self._requested - newest > _MERGED * self._pause.step

    def ahead(self, time: float) -> SlidingWindow:
        """The window, or a copy with more nodes for a time ahead of it.

        Nodes lie as they would without readings until then, up to where the covariance reaches that
        of a robot at rest: the copy then has one node at rest, which is valid from then on.
        """
        window, nodes = self.window, self.window.nodes.time
        newest = float(nodes[-1])
        if time <= newest or self.resting:
            return window
        window = window.copied()
        before = window.before if len(nodes) == 1 else nodes[-2]
        # Nodes may be too close; one beyond the requested time does not change the prediction.
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
        """The time, or that of the newest node if another node would be too close to it."""
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
        """Time of the next node on the way to a time: that time, or earlier in a pause."""
        newest = self.time
        if newest is None or self.resting:
            return time
        stop = self._pause.next_node(newest, time, self.buffer)
        return stop if time - stop >= self._least else time

    def _step(self, time: float) -> float:
        """Append a node, unless the time is not new, and use new readings; the newest time."""
        before = self.time
        self._append(time)  # predicted by the prior's mean (2')
        newest = float(self.window.nodes.time[-1])
        fresh, earliest = self._arrive()
        if fresh or before is None or newest > before:
            starts = bool(fresh) and not self._started
            if starts:
                self._started = self.update.start(fresh)  # the whole window, as a recording
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
                if curved:  # readings may be far from the tip
                    self._pause.note(self._spread(self.window))
            elif self._started:
                self._note_pause(newest)
            self._marginalize()  # the Schur complement of nodes that leave (20)
            self.updates += 1
        return newest

    def _append(self, time: float) -> None:
        """Append a node after the newest; before the first reading the only node is at rest."""
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
        """Begin again with a single node at rest."""
        window = self.window
        if window.lone != self._pause.lone:
            window.lone, self._cov_at_rest = self._pause.lone, None
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
        """Whether the estimate is that of the prior at rest."""
        return not self._started and self._pause.has_rest

    @property
    def read(self) -> bool:
        """Whether readings lie in the last interval."""
        window = self.window
        held = self.buffer.since(window.since(len(window.nodes) - 1))
        return bool(held.streams or held.which.size)

    def _note_pause(self, newest: float) -> None:
        """Restart where the newest state is as uncertain as that of a robot at rest."""
        spread = self._spread(self.window)
        self._pause.note(spread)
        if self._pause.is_at_rest(spread, newest):
            self._restart(newest, Counter())

    @property
    def curved(self) -> bool:
        """Whether the covariance is too large to be linear, as after a pause."""
        return self._pause.curved or self.resting

    def newest(self) -> StateEstimate:
        """The newest state; with the spread of shapes where the covariance is too large."""
        linear = self.window.newest_nodes()
        if not self.curved:
            return linear
        cov = self._cov_at_rest if self.resting else None
        if cov is None:
            cov = shape_covariances(self.window.arclength, *self.window.newest())
            self._cov_at_rest = cov if self.resting else self._cov_at_rest
        return ShapeSpread(linear.pose, linear.strain, linear.velocity, cov.copy())

    def _arrive(self) -> tuple[Counter[str], float]:
        """Hold new readings up to the newest node: number by stream, and the earliest time."""
        time = self.window.nodes.time
        return self.buffer.arrive(float(time[0]), float(time[-1]))

    def _marginalize(self) -> None:
        """Marginalise nodes and discard readings that are older than the lag and the reach."""
        while len(self.window.nodes) > self.lag and not self._is_in_reach:
            self.window.drop()
        if not self.resting:
            self._oldest = float(self.window.nodes.time[0])
        self.buffer.forget(min(self._oldest, self.window.since(0)))

    @property
    def _is_in_reach(self) -> bool:
        """Whether the oldest node is needed to reach back far enough."""
        time = self.window.nodes.time
        return bool(time[-1] - time[1] < self.reach) and time.size <= _MOST

    def _restart(self, since: float, fresh: Counter[str]) -> None:
        """Restart from rest, where states are absurd or no longer determined by readings."""
        self.restarts += 1
        newest = float(self.window.nodes.time[-1])
        self._begin_again(max(since, self._oldest) if fresh else newest, fresh)

    def _begin_again(self, oldest: float, fresh: Counter[str]) -> None:
        """Begin with a robot at rest at a time, and use the readings from there on."""
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
        """Restart from rest with the readings since a time, or without those no shape explains.

        A robot whose base the prior does not fix has no state of rest: the error is raised. So it
        is if readings are far beyond reach, as in another unit, and none were explained before.
        """
        newest = float(self.window.nodes.time[-1])
        try:
            if not restart:
                raise error
            self._restart(since, fresh)
        except _BREAKDOWNS as second:
            prior, grid = self.window.prior, self.window.grid()
            streams = self.buffer.streams(-np.inf)
            far = None if self._explained else unreachable_readings(grid, prior, streams)
            if prior.fixes_base:
                self.update.refuse(fresh)
                self._begin_again(newest, fresh)
            if far or not prior.fixes_base:
                raise breakdown(second, grid, prior, streams) from second

    def _solve(self, first: int, fresh: Counter[str]) -> None:
        """Solve from a node on, with the new readings that pass the gate."""
        self.update.update(first, fresh, linear=not self._pause.curved)


def _begin_at_rest(window: SlidingWindow, time: float, *, solve: bool = True) -> None:
    """Begin a window with one node of a robot at rest."""
    window.begin(time, window.prior.rest_state(Grid(window.arclength, [time])).take(0))
    if solve:
        window.solve(0, HeldReadings())
