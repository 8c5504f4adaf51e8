"""Online: the newest state with its covariance while readings come in, and what came before it.

A fixed-lag smoother: the last time nodes are estimated together, what is older is a prior on them.
Readings may come late, out of order, twice or not at all; each is checked against what all others
say before it is believed. Source: Särkkä and Svensson, *Bayesian
Filtering and Smoothing* (2nd ed.), chapter 12.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glissando._kernels.threads import one_thread
from glissando.errors import OutsideGridError
from glissando.estimation.channels import place_in_channel
from glissando.estimation.contact import ContactScan, force_variance, scan_of, with_forces
from glissando.estimation.contact_evidence import ErrorPrior, error_priors, force_evidence
from glissando.estimation.delays import delayed
from glissando.estimation.given import (
    arclength_nodes,
    model_of,
    require_gate,
    require_jacobians,
    require_kind,
    require_model,
    require_window,
)
from glissando.estimation.loads import require_mechanics
from glissando.estimation.online_monitor import OnlineMonitor
from glissando.estimation.posterior import Posterior
from glissando.estimation.predicted import predicted
from glissando.estimation.shape_spread import ShapeSpread, spread_between
from glissando.estimation.sliding_window import SlidingWindow
from glissando.estimation.state_estimate import StateEstimate, spread, state_at
from glissando.estimation.window_parameters import NotLinearError
from glissando.estimation.window_steps import WindowSteps
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, points_of
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Marginals

_DATED = 4  # time nodes at least, where a delay is estimated: readings have to settle in them
_STEP = 0.1  # s between the time nodes of a first call, if the prior has digits for it
_BEYOND = 1.5  # times as far back, for slopes at the oldest node


class FixedLagSmoother:
    """A smoother over the last time nodes of a prior on fixed arclength nodes.

    A reading is refused when its innovation would come by chance once in 1 / `gate` times, unless
    its stream has been refused for long; of an update half are at most, or five of few. Where the
    prior knows mechanics, none is that a touch explains. One thread at a time may use it.
    """

    def __init__(
        self,
        model: Prior | Robot,
        arclength: ArrayLike,
        *,
        window: int = 4,
        sensor_parameters: Sequence[SensorParameter] | None = None,
        gate: float | None = 1e-6,
    ) -> None:
        """Make a smoother without readings.

        Args:
            model: The robot, or the prior of its motion.
            arclength: Arclength nodes (N,), metres.
            window: Time nodes to keep; 1 is a filter. Where a delay is estimated they are four at
                least, and as many as it takes to reach back as far as it may be.
            sensor_parameters: Applied where they are known, estimated where they are not. Those of
                the robot unless given; of a prior none.
            gate: Chance below which an innovation is refused; None refuses none.

        Raises:
            OutsideGridError: The window is empty or no whole number, or nodes are in millimetres.
            GlissandoError: The prior is none, or two sensor parameters have one name.
        """
        require_window(window)
        require_gate(gate)
        prior, sensor_parameters = model_of(model, sensor_parameters)
        self.arclength = arclength_nodes(arclength)
        require_model(prior, self.arclength, sensor_parameters)
        self._window = SlidingWindow(prior, self.arclength, sensor_parameters)
        _meet(prior, self.arclength)
        self._known = [p for p in sensor_parameters if p.known]
        self._late, others = delayed(sensor_parameters)
        self.lag = window = max(window, _DATED) if self._late else window
        self._steps = WindowSteps(self._window, window, gate)
        self._monitor = OnlineMonitor(prior, self.arclength)
        self._errors: ErrorPrior | None = None  # of the window's first node, for contacts
        self._undelayed: WindowSteps | None = None  # the motion by which delays are known
        self._shown = prior.fixes_base
        if self._late:  # slopes at the oldest node take one before it
            undelayed = SlidingWindow(prior, self.arclength, others)
            self._window.date_by(undelayed)
            self._undelayed = WindowSteps(undelayed, window + 2, gate)

    def __repr__(self) -> str:
        time = "before its first update" if self.time is None else f"at {self.time:.6g} s"
        lost = sum(count.total() for count in self.dropped.values())
        return (
            f"<FixedLagSmoother {time}, window {self.lag}, fits {self.fits}, {lost} readings "
            f"dropped>"
        )

    @property
    def time(self) -> float | None:
        """Time of the newest node, None before the first."""
        return self._steps.time

    def add(self, readings: Readings) -> None:
        """Take readings of one stream, told apart by `name`; they are used when time reaches them.

        Those that came before, lie before the window, off the robot, or more than two seconds ahead
        of the time that is advanced to are dropped and counted in `dropped`.

        Raises:
            SensorError: The stream changed its kind.
        """
        require_kind(readings, Readings, "stream", "give the readings of one sensor at a time")
        require_jacobians(self._window.prior, self.arclength, [readings])
        readings = corrected(readings, self._known)
        self._monitor.check_places(readings)
        if self._undelayed is not None and readings.name not in self._late:
            self._undelayed.take(readings)
            self._shown |= readings.fixes_base and len(readings) > 0
        self._steps.take(readings)

    def advance(self, time: float) -> StateEstimate:
        """Go on to a time with all readings up to then; the newest state at the nodes (N,).

        A time that is not after the newest node's, or hardly, changes nothing but brings in what
        came late. Where times are closer than the prior has digits for, there is no node at each of
        them: the state is then predicted from the newest node.

        Args:
            time: Seconds.

        Raises:
            OutsideGridError: The time is not finite, or lies seconds before all that is estimated.
        """
        if np.ndim(time) or np.asarray(time).dtype.kind not in "fiu" or not np.isfinite(time):
            raise OutsideGridError(f"The time to advance to is {time!r}; give seconds, a number.")
        time = float(time)
        with one_thread():
            if self._undelayed is not None:
                self._reach_back(self._undelayed)
                if self._shown:
                    self._undelayed.advance(time)
            self._steps.advance(time)
            self._monitor.check_state(self._window.nodes.newest[0], self._steps.restarts)
            self._monitor.check_times(self.dropped)
            if self._steps.behind:
                return self.at(self.arclength, time)
            return self._steps.newest()

    def _reach_back(self, undelayed: WindowSteps) -> None:
        """Keep nodes as far back as delayed readings may have been taken.

        One that leaves the window before it is placed is lost, and with every one that does the
        delay looks longer.
        """
        window = self._window
        self._steps.reach = window.longest_delay if window.started else 0.0
        undelayed.reach = self._steps.reach * _BEYOND

    def newest(self) -> StateEstimate:
        """The newest state at the nodes (N,) with covariance (N, 18, 18)."""
        self._require_started()
        return self._steps.newest()

    def _require_started(self) -> None:
        if not self._window.started:
            raise OutsideGridError("There is no estimate yet; call advance(time) first.")

    def posterior(self) -> Posterior:
        """The window as a posterior, to query, draw and save like any other."""
        self._require_started()
        return self._window.posterior()

    def contacts(
        self, *, std_force: ArrayLike | None = None, false_alarms: float = 0.01
    ) -> ContactScan:
        """A scan of the newest state for something that touches, see `scan_contacts`.

        It is best asked after every update, as it remembers by how much shapes before differed. A
        state whose last interval has no readings says nothing of what touches.
        """
        self._require_started()
        prior, nodes = require_mechanics(self.prior), self._window.nodes
        step, cov = self._window.newest_step()
        errors = error_priors(prior, Grid(self.arclength, nodes.time), nodes.state, self._errors)
        self._errors, newest = errors[0], (errors[-1], nodes.state.take(-1), cov, step)
        evidence = force_evidence(prior, self.arclength, *newest)
        evidence = evidence if self._steps.read else evidence.uninformative()
        variance = force_variance(prior, self.arclength, std_force)
        scan = scan_of(evidence, errors[-1].time, variance, false_alarms)
        if len(nodes) == 1 and self._window.before is None:
            return scan
        if not scan.evidence > scan.threshold:
            return scan.without_force()
        row = np.array([len(nodes) - 1])
        return with_forces(self._window.posterior(), [scan], row, variance)[0]

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance inside the window, or ahead of it as the prior predicts.

        Far ahead, and while nothing was read, that is what is known of a robot at rest.

        Args:
            arclength: Metres; broadcast with `time`.
            time: Seconds.

        Raises:
            OutsideGridError: A point lies off the robot or before the window, or is not finite.
        """
        self._require_started()
        place, when = points_of(arclength, time)
        if not np.isfinite(when).all():
            raise OutsideGridError(f"The time asked for is {time!r}; give finite seconds.")
        if self._steps.resting:  # a robot at rest is known as well at any later time
            when = np.minimum(when, float(self._window.nodes.time[-1]))
        wide = self._steps.curved and self.arclength.size > 1
        if np.all(when == self.time):  # as a rule, and then older nodes are not needed
            state, cov, grid = self.newest_node()
            known = partial(spread, grid, Marginals(cov[np.newaxis], np.zeros((0, *cov.shape))))
            at = state_at(self.prior, grid, state.take(np.newaxis), known, place, when)
            return spread_between(self.arclength, self.newest(), place, at) if wide else at
        window = self._steps.ahead(float(np.max(when, initial=-np.inf)))
        begins, newest = float(window.nodes.time[0]), float(self._window.nodes.time[-1])
        late = when >= begins
        if late.all() or begins <= newest:
            return predicted(window, place, when, newest)
        ahead = predicted(window, place[late], when[late], newest)
        return _merged(late, self.at(place[~late], when[~late]), ahead)

    def placed(self, readings: Readings) -> Readings:
        """Readings of a sensor in a channel, as those where the newest shape puts it. (M8)."""
        if readings.channel is None:
            return readings
        state, _, grid = self.newest_node()
        return place_in_channel(readings, self.prior, grid, state.take(np.newaxis))

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
            self._window.solve(0, self._steps.update.readings(0))
            moved = float(np.abs(self._window.nodes.step).max())
        with suppress(NotLinearError):
            self._window.settle()
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
    def updates(self) -> int:
        """How many updates there were."""
        return self._steps.updates

    @property
    def restarts(self) -> int:
        """How often it began again from rest."""
        return self._steps.restarts

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
        return self._steps.gate.dropped

    @property
    def nis(self) -> float | None:
        """Mean squared innovation per degree of freedom of late; 1 when the model fits."""
        return self._steps.gate.nis

    @property
    def fits(self) -> bool:
        """Whether innovations of late are as small as chance allows, the robot within its reach."""
        return self._steps.gate.fits and not self._monitor.beyond


def _merged(late: NDArray[np.bool_], early: StateEstimate, other: StateEstimate) -> StateEstimate:
    """States of two kinds of points, by which of all points (…) are of the second."""
    spread = ShapeSpread in (type(early), type(other))
    if spread:
        early, other = (
            e if isinstance(e, ShapeSpread) else ShapeSpread.of(e) for e in (early, other)
        )
    out = []
    for name in ("pose", "strain", "velocity", "cov"):
        one, two = getattr(early, name), getattr(other, name)
        values = np.empty((*late.shape, *one.shape[1:]))
        values[~late], values[late] = one, two
        out.append(values)
    return ShapeSpread(*out) if spread else StateEstimate(*out)


def _meet(prior: Prior, arclength: Array) -> None:
    """Call what updates call of a prior, so that its kernels are there before any reading is."""
    step = max(_STEP, prior.least_step(arclength))
    grid = Grid(arclength, [0.0, step])
    rest = prior.rest_state(grid)
    for _ in (*prior.factors(grid, rest, rest, slice(0, 2)), *prior.static_factors(grid, rest)):
        pass
    s, t = np.meshgrid([arclength[0], arclength[:2].mean()], [0.0, 0.5 * step])
    for points in sort_points(grid, s.ravel(), t.ravel()):
        prior.interpolate(grid, rest, rest, points)
