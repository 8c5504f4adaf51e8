"""Factors of a window's intervals, linearised at its nodes and summed. Source: (19)."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from glissando.estimation.channels import place_in_channel
from glissando.estimation.delay_dating import DelayDating
from glissando.estimation.held_readings import HeldReadings
from glissando.estimation.linearized_readings import LinearizedReadings
from glissando.estimation.undated_readings import moved_within, shows_motion, widened
from glissando.estimation.window_nodes import Nodes
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid
from glissando.model.interpolation import sort_points
from glissando.model.priors.prior import Prior, load_kernels, without_roll_transport
from glissando.model.priors.white_noise import WhiteNoisePrior
from glissando.model.sensors.compiled_readings import is_compiled
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.sensors.readings import Readings
from glissando.model.state import DOF
from glissando.solver.located_readings import locate
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import NormalEquationsBuilder

_STEP = 0.1  # s between the time nodes of a first call, if the prior's numerics allow it


class WindowFactors:
    """The factors of a prior and of readings with uncertain `parameters` of their sensors.

    Attributes:
        prior: The prior of the motion.
        dating: Dating of the readings of streams with an estimated delay, if there are any.
        held: Readings that were last summed.
        terms: Linearisation of these readings.
    """

    held: HeldReadings

    def __init__(
        self, prior: Prior, arclength: Array, parameters: Sequence[SensorParameter]
    ) -> None:
        summed = ["white_noise"] if type(prior) is WhiteNoisePrior else []
        load_kernels(prior, "static_steps", "window", *summed)
        self.prior, self._arclength, self._parameters = prior, arclength, tuple(parameters)
        self._used_prior = prior  # without transport by roll, once readings resolve the axes
        self.dating: DelayDating | None = None
        self.terms: list[LinearizedReadings] = []
        if type(prior) is WhiteNoisePrior:
            self._along = prior.arclength_densities(arclength)

    def with_prior(self, prior: Prior) -> WindowFactors:
        """A copy with another prior."""
        out = copy(self)
        if prior is not self.prior:
            out.prior = out._used_prior = prior
        return out

    def takes_as_row(self, readings: Readings) -> bool:
        """Whether readings may be stored as rows, together with those of other streams."""
        fits = type(self.prior) is WhiteNoisePrior and self.dating is None
        known = all(readings.name not in p.streams for p in self._parameters)
        return fits and known and is_compiled(readings) and not readings.resolves_axes

    def add(
        self, nodes: Nodes, grid: Grid, readings: HeldReadings, builder: NormalEquationsBuilder
    ) -> None:
        """Linearise the intervals of nodes on a grid and sum their factors."""
        self.terms, self.held = [], readings
        self._keep_axes(readings.streams)
        prior, state = self._used_prior, nodes.state
        if type(prior) is WhiteNoisePrior and self.dating is None:
            densities, rows = (self._along, prior.time_densities(grid.time)), readings.which
            memory = *readings.rows.memory, rows
            linearized = prior.accumulate(grid, state, densities, memory, builder.sums)
            if rows.size:
                at, slopes, *terms, weights = linearized
                batch = Factors(at, slice(0, DOF), slopes, Residuals(*terms))
                self.terms.append(LinearizedReadings(None, rows, batch, weights))
        else:
            for batch in prior.factors(grid, state, state, slice(0, len(nodes))):
                builder.accumulate(self._moving(batch, nodes))
        if readings.streams or self._parameters:
            self._add_streams(readings.streams, grid, nodes, builder)

    def _keep_axes(self, streams: Sequence[Readings]) -> None:
        """Omit transport by roll from the prior, once a stream resolves the body's axes."""
        if self._used_prior is self.prior and any(r.resolves_axes for r in streams):
            self._used_prior = without_roll_transport(self.prior)
            if type(self._used_prior) is WhiteNoisePrior:
                self._along = self._used_prior.arclength_densities(self._arclength)

    def _add_streams(
        self,
        streams: Sequence[Readings],
        grid: Grid,
        nodes: Nodes,
        builder: NormalEquationsBuilder,
    ) -> None:
        """Add the streams that are not stored as rows, and the drift of the sensor parameters."""
        known = self._parameters, nodes.parameters
        placed = [place_in_channel(r, self.prior, grid, nodes.state) for r in streams]  # (M8)
        motion = None if self.dating is None else self.dating.motion
        located = replace(locate(grid, placed, *known, keep_all=True), motion=motion)
        factors = measurement_factors(self.prior, located, nodes.state, nodes.state)
        undated = self.dating and grid.before is None and not shows_motion(streams)
        for stream, rows, batch in factors:
            if self.dating is not None:
                if undated:
                    lag = self.dating.counting.lag(streams[stream].name)
                    batch = self._undated(batch, nodes, lag) if lag else batch
                self.dating.see_slopes(streams[stream].name, batch)
            moving = self._moving(batch, nodes)
            weights = moving.terms.robust_weights()
            builder.accumulate(moving, weights)
            self.terms.append(LinearizedReadings(streams[stream], rows, moving, weights))
        if self._parameters:
            builder.accumulate_drift(*located.parameters.process.drift(nodes.parameters))

    def _moving(self, factors: Factors, nodes: Nodes) -> Factors:
        """Factors of a motion that moves with the estimated delays, if there are any."""
        return factors if self.dating is None else self.dating.moving(factors, nodes)

    def _undated(self, factors: Factors, nodes: Nodes, lag: float) -> Factors:
        """Readings of a window without motion, with noise for a delay of `lag` s added."""
        moves = moved_within(self.prior, self._arclength, nodes.state, lag)
        return widened(factors, moves.reshape(2 * [self._arclength.size, nodes.state.dof]))


def warm_up_kernels(prior: Prior, arclength: Array) -> None:
    """Call all kernels of a prior once, so that they are compiled before the first reading.

    Args:
        prior: The prior of the motion.
        arclength: Arclength nodes (N,), m.
    """
    step = max(_STEP, prior.least_step(arclength))
    grid = Grid(arclength, [0.0, step])
    rest = prior.rest_state(grid)
    for _ in (*prior.factors(grid, rest, rest, slice(0, 2)), *prior.static_factors(grid, rest)):
        pass
    s, t = np.meshgrid([arclength[0], arclength[:2].mean()], [0.0, 0.5 * step])
    for points in sort_points(grid, s.ravel(), t.ravel()):
        prior.interpolate(grid, rest, rest, points)
