"""Online: the newest state with its covariance while readings come in, and what came before it.

A fixed-lag smoother: the last time nodes are estimated together, what is older is a prior on them.
Readings may come late, out of order, twice or not at all; each is checked against what all others
say before it is believed. Source: Särkkä and Svensson, *Bayesian
Filtering and Smoothing* (2nd ed.), chapter 12.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from glissando._kernels.jit import load
from glissando._kernels.threads import one_thread
from glissando.errors import OutsideGridError, UnobservableError
from glissando.estimation.contact import ContactScan, scan_contacts
from glissando.estimation.delays import delayed
from glissando.estimation.gated_update import GatedUpdate, LostError
from glissando.estimation.innovation_gate import InnovationGate
from glissando.estimation.posterior import Posterior, StateEstimate
from glissando.estimation.reading_buffer import ReadingBuffer
from glissando.estimation.shape_spread import shape_covariances, spread_of
from glissando.estimation.silence import Silence
from glissando.estimation.sliding_window import SlidingWindow
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_MERGED = 0.01  # of the longest interval: a node as close to the newest one would be singular
_BACK = 2.0  # s before the oldest node: a clock that was set, not a reading that came late
_CLOSEST = 0.2  # of the last interval: no node is put nearer to the newest one to look ahead


class FixedLagSmoother:
    """A smoother over the last time nodes of a prior on fixed arclength nodes.

    A reading is refused when its innovation would come by chance once in 1 / `gate` times, unless
    its stream has been refused for long. One thread at a time may use it.
    """

    def __init__(
        self,
        prior: Prior,
        arclength: ArrayLike,
        *,
        window: int = 4,
        sensor_parameters: Sequence[SensorParameter] = (),
        gate: float | None = 1e-6,
    ) -> None:
        """Make a smoother without readings.

        Args:
            prior: What is believed before any reading.
            arclength: Arclength nodes (N,), metres.
            window: Time nodes to keep; 1 is a filter.
            sensor_parameters: Applied where they are known, estimated where they are not.
            gate: Chance below which an innovation is refused; None refuses none.

        Raises:
            OutsideGridError: The window is empty.
        """
        if window < 1:
            raise OutsideGridError(f"A window of {window} time nodes is empty; give 1 or more.")
        load()
        self.arclength = np.asarray(arclength, dtype=float)
        _meet(prior, self.arclength)
        self.lag = window
        self.updates = self.restarts = 0
        self._known = [p for p in sensor_parameters if p.known]
        self._window = SlidingWindow(prior, self.arclength, sensor_parameters)
        self._late, others = delayed(sensor_parameters)
        self._undelayed: FixedLagSmoother | None = None  # the motion by which delays are known
        self._shown = prior.fixes_base
        if self._late:  # slopes at the oldest node take one before it
            self._undelayed = FixedLagSmoother(
                prior, arclength, window=window + 2, sensor_parameters=others, gate=gate
            )
            self._window.undelayed = self._undelayed._window
        self._gate = InnovationGate(gate)
        self._buffer = ReadingBuffer(float(self.arclength[-1]), self._gate)
        self._update = GatedUpdate(self._window, self._buffer, self._gate)
        self._started = False
        self._oldest, self._silence = -np.inf, Silence()

    @property
    def time(self) -> float | None:
        """Time of the newest node, None before the first."""
        return float(self._window.nodes.time[-1]) if self._window.started else None

    def add(self, readings: Readings) -> None:
        """Take readings of one stream, told apart by `name`; they are used when time reaches them.

        Those that came before, lie before the window, off the robot, or absurdly far ahead are
        dropped and counted in `dropped`.

        Raises:
            SensorError: The stream changed its kind.
        """
        if self._undelayed is not None and readings.name not in self._late:
            self._undelayed.add(readings)
            self._shown |= readings.fixes_base and len(readings) > 0
        self._buffer.take(corrected(readings, self._known), self._oldest)

    def advance(self, time: float) -> StateEstimate:
        """Go on to a time with all readings up to then; the newest state at the nodes (N,).

        A time that is not after the newest node's, or hardly, changes nothing but brings in what
        came late.

        Args:
            time: Seconds.

        Raises:
            OutsideGridError: The time is not finite, or lies seconds before all that is estimated.
        """
        if not np.isfinite(time):
            raise OutsideGridError(f"The time to advance to is {time}; give seconds.")
        time = self._new_time(time)
        if self._undelayed is not None and self._shown:
            self._undelayed.advance(time)
        with one_thread():
            self._buffer.refuse_ahead(max(time, self.time or time))
            while self._step(self._next_node(time)) < time:
                pass
            return self._newest_nodes()

    def _new_time(self, time: float) -> float:
        """The time, or the newest node's where a node at it would be too close to that."""
        if not self._window.started:
            return time
        nodes, before = self._window.nodes.time, self._window.before
        if time < nodes[0] - _BACK:
            raise OutsideGridError(
                f"Time went back from {nodes[-1]:g} to {time:g} s; the clock was set. Begin anew "
                f"with another smoother, and give times of a monotonic clock."
            )
        spans = np.diff(nodes if before is None else np.append(before, nodes))
        close = float(time - nodes[-1]) < _MERGED * spans.max(initial=0.0)
        return float(nodes[-1]) if close else time

    def _next_node(self, time: float) -> float:
        """The next node on the way to a time: that time, but in silence nodes lie closer."""
        newest = self.time
        if newest is None or self._resting:
            return time
        return self._silence.next_node(newest, time, self._buffer)

    def _step(self, time: float) -> float:
        """One node more, or none if the time is not new, with what came; the newest time."""
        before = self.time
        self._append(time)  # the prior's mean leads there (2')
        newest = float(self._window.nodes.time[-1])
        fresh, earliest = self._arrive()
        if fresh or before is None or newest > before:
            if not self._started and fresh:
                self._started = self._update.start(fresh)  # all there is, as in a batch
            try:
                self._solve(self._update.first_changed(earliest), fresh)  # (19) to (21), gated
            except (np.linalg.LinAlgError, UnobservableError, LostError):
                if not self._started:
                    raise
                self._restart(min(earliest, newest - self._silence.step), fresh)
            if fresh.total():
                self._silence.end(before, newest)
            elif self._started:
                self._note_silence(newest)
            self._marginalize()  # the Schur complement of what leaves (20)
            self.updates += 1
        return newest

    def _append(self, time: float) -> None:
        """A node at a time after the newest; while nothing was read there is but one, at rest."""
        window = self._window
        if window.started and time <= window.nodes.time[-1]:
            return
        if window.started and not self._resting:
            window.append(time)
            return
        begin, silence = time, self._silence
        if window.started:
            silence.step = min(silence.step, time - float(window.nodes.time[-1]))
            due = self._buffer.due(time)
            if due.size:
                begin = max(self._oldest, min(float(due[0]), time - silence.step))
        else:
            self._oldest = time
        self._rest(begin)
        if begin < time:
            window.append(time)

    def _rest(self, time: float) -> None:
        """A single node at rest."""
        window = self._window
        window.begin(time, window.prior.rest_state(Grid(self.arclength, [time])).take(0))
        self._started = self._silence.curved = False
        if window.prior.fixes_base and not self._silence.has_rest:
            window.solve(0, [])
            self._silence.set_rest(self._spread(), float(self.arclength[-1]))

    def _spread(self) -> tuple[float, float]:
        """RMS displacement (m) and turn (rad) of the newest tip."""
        state, cov = self._window.newest()
        return spread_of(cov, self.arclength.size - 1, state.dof)

    @property
    def _resting(self) -> bool:
        """Whether nothing is known but the prior."""
        return not self._started and self._silence.has_rest

    def _note_silence(self, newest: float) -> None:
        """Begin again where the newest state is no better known than that of a robot at rest."""
        spread = self._spread()
        self._silence.note(spread)
        if self._silence.is_at_rest(spread):
            self._restart(newest, Counter())

    def _newest_nodes(self) -> StateEstimate:
        """The newest state; after silence with the spread of shapes."""
        linear = self._window.newest_nodes()
        if not (self._silence.curved or self._resting):
            return linear
        return replace(linear, cov=shape_covariances(self.arclength, *self._window.newest()))

    def _arrive(self) -> tuple[Counter[str], float]:
        """New readings up to the newest node: how many of each stream, and the earliest's time."""
        time = self._window.nodes.time
        return self._buffer.arrive(float(time[0]), float(time[-1]))

    def _marginalize(self) -> None:
        """Let nodes and readings go that are older than the lag."""
        while len(self._window.nodes) > self.lag:
            self._window.drop()
        if not self._resting:
            self._oldest = float(self._window.nodes.time[0])
        self._buffer.forget(self._oldest)

    def _restart(self, since: float, fresh: Counter[str]) -> None:
        """Begin again from rest, where states have become absurd or say nothing more."""
        newest = float(self._window.nodes.time[-1])
        self._oldest = max(since, self._oldest) if fresh else newest
        self._rest(self._oldest)
        self.restarts += 1
        self._buffer.forget(self._oldest)
        if self._oldest < newest:
            self._window.append(newest)
        if fresh:
            self._started = self._update.start(fresh)
        self._solve(0, fresh)

    def _solve(self, first: int, fresh: Counter[str]) -> None:
        """Solve from a node on, with the new readings that the gate believes."""
        self._update.update(first, fresh, linear=not self._silence.curved)

    def newest(self) -> StateEstimate:
        """The newest state at the nodes (N,) with covariance (N, 18, 18)."""
        self._require_started()
        return self._newest_nodes()

    def _require_started(self) -> None:
        if not self._window.started:
            raise OutsideGridError("There is no estimate yet; call advance(time) first.")

    def posterior(self) -> Posterior:
        """The window as a posterior, to query, draw and save like any other."""
        self._require_started()
        return self._window.posterior()

    def contacts(self, *, std_force: ArrayLike = 1.0, false_alarms: float = 0.01) -> ContactScan:
        """A scan of the newest state for something that touches, see `scan_contacts`."""
        self._require_started()
        posterior = self._window.posterior()
        newest = float(posterior.grid.time[-1])
        return scan_contacts(posterior, newest, std_force=std_force, false_alarms=false_alarms)

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance inside the window, or ahead of it as the prior predicts.

        Args:
            arclength: Metres; broadcast with `time`.
            time: Seconds.

        Raises:
            OutsideGridError: A point lies off the robot or before the window.
        """
        latest = float(np.max(time, initial=-np.inf))
        self._require_started()
        window, nodes = self._window, self._window.nodes.time
        if latest > nodes[-1]:
            window = window.copied()
            before = window.before if len(nodes) == 1 else nodes[-2]
            # Nodes may be too close; one further ahead than asked for does not change the answer.
            least = 0.0 if before is None else _CLOSEST * float(nodes[-1] - before)
            window.append(max(latest, float(nodes[-1]) + least))
            first = max(0, len(window.nodes) - 2)
            readings = self._buffer.since(float(window.nodes.time[first]))
            with one_thread():
                window.solve(first, readings)
        return window.posterior().at(arclength, time)

    def iterate(self, tolerance: float = 1e-9, most: int = 50) -> int:
        """Linearise the whole window again until no number moves by more.

        Args:
            tolerance: Largest move of any number.
            most: Most rounds.

        Returns:
            The rounds it took.
        """
        rounds, moved = 0, np.inf
        while moved >= tolerance and rounds < most:
            rounds += 1
            self._window.relinearize(0)
            self._window.solve(0, self._update.readings(0))
            moved = float(np.abs(self._window.nodes.step).max())
        return rounds

    def newest_node(self) -> tuple[State, Array, Grid]:
        """The newest time by itself: what a plan or another estimate goes on from.

        Returns:
            Estimate (N,), covariance (D, D) of its nodes' numbers and then the sensor parameters',
            and a grid of it alone, which knows what came before.
        """
        self._require_started()
        state, cov = self._window.newest()
        return state, cov, self._window.grid(len(self._window.nodes) - 1)

    @property
    def prior(self) -> Prior:
        """The prior of the motion."""
        return self._window.prior

    @property
    def sensor_parameters(self) -> tuple[SensorParameter, ...]:
        """What of the sensors is estimated, in the order of its numbers."""
        return self._window.sensor_parameters

    @property
    def dropped(self) -> dict[str, Counter[str]]:
        """How many readings of each stream were not used, by reason."""
        return self._gate.dropped

    @property
    def nis(self) -> float | None:
        """Mean squared innovation per degree of freedom of late; 1 when the model fits."""
        return self._gate.nis

    @property
    def fits(self) -> bool:
        """Whether innovations of late are no larger than chance allows."""
        return self._gate.fits


def _meet(prior: Prior, arclength: Array) -> None:
    """Call what updates call of a prior, so that its kernels are there before any reading is."""
    grid = Grid(arclength, [0.0, 0.1])
    rest = prior.rest_state(grid)
    for _ in (*prior.factors(grid, rest, rest, slice(0, 2)), *prior.static_factors(grid, rest)):
        pass
    s, t = np.meshgrid([arclength[0], arclength[:2].mean()], [0.0, 0.05])
    for points in sort_points(grid, s.ravel(), t.ravel()):
        prior.interpolate(grid, rest, rest, points)
