"""Online: the newest state with its covariance while readings come in, and what came before it.

A fixed-lag smoother: the last time nodes are estimated together, what is older is a prior on them.
Readings may come late, out of order, twice or not at all; each is checked against what all others
say before it is believed. Source: Särkkä and Svensson, *Bayesian
Filtering and Smoothing* (2nd ed.), chapter 12.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import NotConvergedWarning, OutsideGridError, UnobservableError
from glissando.estimation.batch import SolverOptions, estimate
from glissando.estimation.innovation_gate import InnovationGate
from glissando.estimation.posterior import Posterior, StateEstimate
from glissando.estimation.reading_buffer import ReadingBuffer
from glissando.estimation.sliding_window import SlidingWindow
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.measurement_factors import MeasurementFactors
from glissando.twins import estimating, prepare

_RENEWED = 2  # intervals before the newest node that an update linearises again
_CLOSE = 0.02  # standard deviations: where the last step missed by less, the newest alone will do
_MISS = 0.1  # standard deviations by which a step may miss before it is followed by another
_MOST = 5  # steps an update
_CLOSEST = 0.2  # of the last interval: no node is put nearer to the newest one to look ahead


class FixedLagSmoother:
    """A smoother over the last `window` time nodes of a prior on `arclength` nodes (N,).

    `sensor_parameters` are applied where they are known and estimated where they are not.
    A reading is refused when its innovation would come by chance once in 1 / `gate` times, unless
    its stream has been refused for long. `window` 1 is a filter. The first one ever made on a
    machine takes half a minute where numba compiles for it. Raises OutsideGridError for an empty
    window.
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
        if window < 1:
            raise OutsideGridError(f"A window of {window} time nodes is empty; give 1 or more.")
        prepare()
        self.arclength = np.asarray(arclength, dtype=float)
        self.lag = window
        self.updates = self.restarts = 0
        self._known = [u for u in sensor_parameters if u.known]
        self._window = SlidingWindow(prior, self.arclength, sensor_parameters)
        self._gate = InnovationGate(gate)
        self._inbox = ReadingBuffer(float(self.arclength[-1]), self._gate)
        self._started, self._missed = False, np.inf

    @property
    def time(self) -> float | None:
        """Time of the newest node, None before the first."""
        return self._window.nodes[-1].time if self._window.nodes else None

    def add(self, readings: Readings) -> None:
        """Take readings of one stream, told apart by `name`; they are used when time reaches them.

        Those that came before, lie before the window, off the robot, or absurdly far ahead are
        dropped and counted in `dropped`. Raises SensorError when the stream changed its kind.
        """
        nodes = self._window.nodes
        span = (nodes[0].time, nodes[-1].time) if nodes else None
        self._inbox.take(corrected(readings, self._known), span)

    def advance(self, time: float) -> StateEstimate:
        """Go on to `time` with all readings up to then; the newest state at the nodes (N,).

        A time that is not after the newest node's changes nothing but brings in what came late.
        Raises OutsideGridError for a time that is not finite.
        """
        if not np.isfinite(time):
            raise OutsideGridError(f"The time to advance to is {time}; give seconds.")
        with estimating():
            window = self._window
            if not window.nodes:
                at = Grid(self.arclength, [time])
                window.begin(time, window.prior.rest_state(at).take(0))
            elif time > window.nodes[-1].time:
                window.append(time)
            fresh, earliest = self._inbox.arrive(window.nodes[0].time, window.nodes[-1].time)
            if not fresh and time < window.nodes[-1].time:
                return window.newest_nodes()
            if not self._started and fresh:
                self._start()
            renewed = _RENEWED if self._missed > _CLOSE else 1
            first = max(0, len(window.nodes) - 1 - renewed)
            late = int(np.searchsorted(window.times, earliest, side="right")) - 1
            try:
                self._update(max(0, min(first, late)), fresh)
            except (np.linalg.LinAlgError, UnobservableError):
                if not self._started:
                    raise
                self._restart()
            while len(window.nodes) > self.lag:
                window.drop()
            self._inbox.forget(window.nodes[0].time)
            self.updates += 1
            return window.newest_nodes()

    def _restart(self) -> None:
        """Begin again from rest: foretold for too long without readings, states are absurd."""
        window = self._window
        rest = window.prior.rest_state(Grid(self.arclength, [0.0])).take(0)
        time, self._started, self.restarts = window.nodes[-1].time, False, self.restarts + 1
        window.begin(time, rest)
        window.before = None
        self._inbox.forget(time)
        window.solve(0, self._placed(0))

    def _start(self) -> None:
        """The first readings: estimate all there is from rest, as a recording is."""
        window = self._window
        readings = self._inbox.since(window.nodes[0].time)
        sensor_parameters, options = window.sensor_parameters, SolverOptions(max_iterations=30)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotConvergedWarning)
                found = estimate(
                    window.prior,
                    window.grid(),
                    readings,
                    sensor_parameters=sensor_parameters,
                    options=options,
                )
        except UnobservableError:
            return  # not yet: some other sensor will fix the base
        for k, node in enumerate(window.nodes):
            node.state, node.step = found.state.take(k), np.zeros_like(node.step)
        self._started = True

    def _update(self, first: int, fresh: Counter[str]) -> None:
        """Solve from a node on, more than once if far; refuse what nothing else agrees with."""
        placed = self._placed(first)
        for _ in range(_MOST):
            self._window.relinearize(first)
            self._window.solve(first, placed)
            self._missed = self._window.miss(first)
            if self._missed < _MISS:
                break
        for again in range(_MOST if fresh else 0):
            if not self._judged(placed, fresh, first_look=not again):
                break
            placed = self._placed(first)
            self._window.solve(first, placed)

    def _placed(self, first: int) -> MeasurementFactors:
        """Readings at and after a node."""
        return self._window.place(first, self._inbox.since(self._window.nodes[first].time))

    def _judged(self, placed: MeasurementFactors, fresh: Counter[str], *, first_look: bool) -> bool:
        """Refuse the new reading that fits the others least, if it is beyond belief.

        One at a time, as a wrong one makes its neighbours look wrong. Returns whether there was.
        """
        worst, wrong = 1.0, None
        streams = [stream for _, stream in placed.streams]
        for judged in self._window.judge([len(r) - fresh[r.label] for r in streams]):
            stream = streams[judged.stream]
            if first_look:
                self._gate.note(stream.label, judged.nis, judged.dof)
            excess = self._gate.excess(stream.label, judged.nis, judged.dof)
            if excess > worst:
                worst, wrong = excess, (stream, judged.rows[int(np.argmax(judged.nis))])
        if wrong is None:
            return False
        stream, row = wrong
        self._gate.strike(stream.label)
        self._inbox.discard(stream.label, float(stream.time[row]), float(stream.arclength[row]))
        fresh[stream.label] -= 1
        return True

    def newest(self) -> StateEstimate:
        """The newest state at the nodes (N,) with covariance (N, 18, 18)."""
        self._any()
        with estimating():
            return self._window.newest_nodes()

    def _any(self) -> None:
        if not self._window.nodes:
            raise OutsideGridError("There is no estimate yet; call advance(time) first.")

    def posterior(self) -> Posterior:
        """The window as a posterior, to query, draw and save like any other."""
        self._any()
        with estimating():
            return self._window.posterior()

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance inside the window, or ahead of it as the prior foretells.

        Raises OutsideGridError for a point off the robot or before the window.
        """
        latest = float(np.max(time, initial=-np.inf))
        self._any()
        window = self._window
        if latest > window.nodes[-1].time:
            window = copy(window)
            window.nodes = [copy(node) for node in window.nodes]
            newest = window.nodes[-1].time
            before = window.nodes[-2].time if len(window.nodes) > 1 else window.before
            # Nodes may be too close; one further ahead than asked for does not change the answer.
            least = 0.0 if before is None else _CLOSEST * (newest - before)
            window.append(max(latest, newest + least))
            first = max(0, len(window.nodes) - 2)
            with estimating():
                readings = self._inbox.since(window.nodes[first].time)
                window.solve(first, window.place(first, readings))
        with estimating():
            return window.posterior().at(arclength, time)

    def iterate(self, tolerance: float = 1e-9, most: int = 50) -> int:
        """Linearise the whole window again until no number moves by more; returns the rounds."""
        with estimating():
            rounds = 0
            moved = np.inf
            while moved >= tolerance and rounds < most:
                rounds += 1
                self._window.relinearize(0)
                self._window.solve(0, self._placed(0))
                moved = max(float(np.abs(node.step).max()) for node in self._window.nodes)
        return rounds

    def newest_node(self) -> tuple[State, Array, Grid]:
        """The newest time by itself: what a plan or another estimate goes on from.

        Estimate (N,), covariance (D, D) of its nodes' numbers and then the unknowns', and a grid
        of it alone, which knows what came before.
        """
        self._any()
        with estimating():
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
