"""Online estimation: the newest states with covariance while readings arrive.

A fixed-lag smoother estimates the last time nodes together; older ones are marginalised into a
prior on them. Readings may be late, out of order, repeated or missing; each is used only if its
innovation against all others passes a gate. Source: Särkkä and Svensson, *Bayesian Filtering and
Smoothing* (2nd ed.), chapter 12.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

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
from glissando.estimation.shape_spread import merged, spread_between
from glissando.estimation.sliding_window import SlidingWindow
from glissando.estimation.state_estimate import StateEstimate, spread, state_at
from glissando.estimation.window_factors import warm_up_kernels
from glissando.estimation.window_parameters import NotLinearError
from glissando.estimation.window_steps import WindowSteps
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, points_of
from glissando.model.priors.prior import Prior
from glissando.model.robot import Robot
from glissando.model.sensors.parameters import SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Marginals

_DATED = 4  # least number of time nodes where a delay is estimated, for readings to converge
_BEYOND = 1.5  # factor on how far the other window reaches back, for slopes at the oldest node


class FixedLagSmoother:
    """Fixed-lag smoother over the last time nodes, on fixed arclength nodes.

    A reading is refused when the probability of so large an innovation is below `gate`, unless its
    stream has been refused for long. An update refuses at most half of its new readings, or five
    if these are few. With a mechanical prior no reading that a contact explains is refused. A
    smoother is not thread-safe.
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
            window: Number of time nodes to keep; 1 is a filter. Where a delay is estimated at least
                four are kept, and as many as span the longest possible delay.
            sensor_parameters: Parameters of the sensors; known ones are applied, others estimated.
                If None, those of the robot; a prior has none.
            gate: Probability below which an innovation is refused; None refuses no reading.

        Raises:
            OutsideGridError: The window is empty or not a whole number, or nodes are in
                millimetres.
            GlissandoError: The model is neither a robot nor a prior, or two sensor parameters have
                the same name.
        """
        require_window(window)
        require_gate(gate)
        time_rate = model.time_rate if isinstance(model, Robot) else 1.0
        prior, sensor_parameters = model_of(model, sensor_parameters)
        self.arclength = arclength_nodes(arclength)
        require_model(prior, self.arclength, sensor_parameters)
        self._window = SlidingWindow(prior, self.arclength, sensor_parameters)
        warm_up_kernels(prior, self.arclength)
        self._known = [p for p in sensor_parameters if p.known]
        self._late, others = delayed(sensor_parameters)
        self.lag = window = max(window, _DATED) if self._late else window
        self._steps = WindowSteps(self._window, window, gate)
        self._monitor = OnlineMonitor(prior, self.arclength, time_rate)
        self._errors: ErrorPrior | None = None  # of the window's first node, for contacts
        self._undelayed: WindowSteps | None = None  # of the motion that determines delays
        self._shown = prior.fixes_base
        if self._late:  # slopes at the oldest node need a node before it
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
        """Time of the newest node, s; None before the first."""
        return self._steps.time

    def add(self, readings: Readings) -> None:
        """Add readings of one stream, identified by `name`, to use when time reaches them.

        Readings that are repeated, lie before the window or off the robot, or are more than two
        seconds ahead of the time given to `advance`, are dropped and counted in `dropped`.

        Raises:
            SensorError: The stream had readings of another class before.
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
        """Advance to a time with all readings up to it; return the newest state at the nodes (N,).

        A time that is not after the newest node's, or only just, adds no node but late readings.
        Where times are closer than the prior's numerics allow, not each of them has a node: the
        state is then predicted from the newest node.

        Args:
            time: Time to advance to, s.

        Raises:
            OutsideGridError: The time is not finite, or lies seconds before the window.
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
            self._monitor.check_start(self._steps.update.ambiguity)
            self._monitor.check_state(self._window.nodes.newest[0], self._steps.restarts)
            self._monitor.check_times(self.dropped)
            if self._steps.behind:
                return self.at(self.arclength, time)
            return self._steps.newest()

    def _reach_back(self, undelayed: WindowSteps) -> None:
        """Keep nodes as far back as delayed readings may have been taken.

        A reading whose time leaves the window before it is used is lost, and every such loss biases
        the delay towards longer values.
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
        """The window as a posterior, to query, plot and save like that of a recording."""
        self._require_started()
        return self._window.posterior()

    def contacts(
        self, *, std_force: ArrayLike | None = None, false_alarms: float = 0.01
    ) -> ContactScan:
        """Scan the newest state for a contact, see `scan_contacts`.

        Call it after every update, as it propagates the covariance of the errors from call to call.
        If the last interval has no readings the scan is uninformative.
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
        """State and covariance inside the window, or predicted by the prior ahead of it.

        Far ahead, and before the first reading, it is the prior's state at rest.

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
        if self._steps.resting:  # a robot at rest has the same covariance at any later time
            when = np.minimum(when, float(self._window.nodes.time[-1]))
        wide = self._steps.curved and self.arclength.size > 1
        if np.all(when == self.time):  # the usual case, which needs no older nodes
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
        return merged(late, self.at(place[~late], when[~late]), ahead)

    def placed(self, readings: Readings) -> Readings:
        """Readings of a sensor in a channel, located by the newest shape (M8); others unchanged."""
        if readings.channel is None:
            return readings
        state, _, grid = self.newest_node()
        return place_in_channel(readings, self.prior, grid, state.take(np.newaxis))

    def iterate(self, tolerance: float = 1e-9, most: int = 50) -> int:
        """Relinearise and solve the whole window until the step is below a tolerance.

        Args:
            tolerance: Largest component of the step that is accepted.
            most: Largest number of rounds.

        Returns:
            Number of rounds.
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
        """Marginal of the newest time, from which a plan or another estimate continues.

        Returns:
            Estimate (N,); covariance (D, D) of the unknowns of its nodes, then of the sensor
            parameters; and a grid of this time alone, with the time of the node before.
        """
        self._require_started()
        state, cov = self._window.newest()
        return deepcopy(state), cov, self._window.grid(len(self._window.nodes) - 1)

    @property
    def updates(self) -> int:
        """Number of updates."""
        return self._steps.updates

    @property
    def restarts(self) -> int:
        """Number of restarts from rest."""
        return self._steps.restarts

    @property
    def prior(self) -> Prior:
        """The prior of the motion."""
        return self._window.prior

    @property
    def sensor_parameters(self) -> tuple[SensorParameter, ...]:
        """Sensor parameters that are estimated, in the order of their unknowns."""
        return self._window.sensor_parameters

    @property
    def dropped(self) -> dict[str, Counter[str]]:
        """Number of readings of each stream that were not used, by reason."""
        return self._steps.gate.dropped

    @property
    def nis(self) -> float | None:
        """Mean recent squared innovation per degree of freedom; 1 when the model fits."""
        return self._steps.gate.nis

    @property
    def fits(self) -> bool:
        """Whether recent innovations are as small as chance allows, the robot within its reach."""
        return self._steps.gate.fits and not self._monitor.beyond
