"""What is known of delays: a motion dates only the readings that did not show it.

Where all streams share a delay, a later motion explains their readings as well as this one: a prior
that is the same at all times cannot tell. Gauss–Newton steps do not see that, as they leave out the
curvature of the residuals, and would have the delay known from the motion that its own readings
gave. So a delay is seen by the motion x₀ that streams without one give, and what is left of the
motion, x − x₀, moves with it: with c = ∂(x − x₀)/∂t at the nodes, x = x′ + c d, and d enters the
readings by ∂x₀/∂t alone. Streams that each have a delay of their own do not date one another. Noise
makes a robot at rest seem to move; what that would tell of a delay is drawn and taken off.
Online, x₀ is that of a second smoother, which streams with a delay never reach: see `delay_dating`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from glissando.errors import UnobservableError
from glissando.estimation.starting_point import with_parameters
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, factor
from glissando.solver.gauss_newton import Solution, SolverOptions, Stopwatch, minimize
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import Layout, NormalEquationsBuilder

_DRAWS = 4  # of noise, for what it tells of a delay
_ALIKE = 3.0  # numbers of readings whose noise tells of a delay as one does, at a guess
_STEPS = 15  # in which delays settle
_HELD = 1e14  # s⁻²: of a delay that is held
_MOTION = 0.03  # standard deviations a number by which a motion that dates delays may be off


def with_unseen_delays(
    prior: Prior,
    solution: Solution,
    sensor_parameters: Sequence[SensorParameter],
    options: SolverOptions,
) -> Solution:
    """A solution in which delays are known by what streams without one show, and no better.

    Args:
        prior: The prior.
        solution: Where the iteration ended; its memory is overwritten.
        sensor_parameters: Parameters of the sensors.
        options: When to stop the estimate from the streams without a delay.

    Returns:
        The solution with another information matrix, if a delay is estimated; else the same.
    """
    process = solution.located.parameters.process
    delays = delay_columns(process)
    if not delays:
        return solution
    late, others = delayed(sensor_parameters)
    streams = [r for r in solution.located.streams if r.name not in late]
    grid, state = solution.located.grid, solution.state
    motion, noise = prior.rest_state(grid), None
    if streams:
        with suppress(UnobservableError, np.linalg.LinAlgError):  # they show no motion
            values = solution.located.parameters.by_name()
            alone = with_parameters(locate(grid, streams, others), values)
            rough = options.rougher(state.pose.shape[0] * state.numbers, _MOTION)
            shown = minimize(prior, alone, state, rough, None, Stopwatch(), solution)
            rng = np.random.default_rng(0)
            noise = [_motion_of_noise(prior, shown, rng) for _ in range(_DRAWS)]
            motion = shown.state
    moving = replace(solution.located, motion=motion)
    shares = dict.fromkeys(late, 0.0)
    if noise is not None:
        shares = _shares(prior, moving, noise, solution, late)
    return _settled(prior, replace(moving, shares=shares), motion, solution, options)


def _settled(
    prior: Prior,
    located: LocatedReadings,
    motion: State,
    solution: Solution,
    options: SolverOptions,
) -> Solution:
    """Where steps lead in which delays move by what the motion tells of them, and nothing else.

    The least cost would have readings fall between those of other streams, where a motion that may
    bend freely contradicts them least, whatever their delay is. Where the motion tells nothing, or
    steps lead nowhere, it stays at the least cost, of which delays are as uncertain as stated.
    """
    if any(located.shares.values()):
        here = _Settling(prior, located, motion, solution)
        for _ in range(_STEPS):
            if here.length < options.tolerance:
                return here.solution()
            here.step()
    nothing = replace(located, shares=dict.fromkeys(located.shares, 0.0))
    return _Settling(prior, nothing, motion, solution).solution()


class _Settling:
    """Steps of a solution in which delays are known by a motion, and information there."""

    def __init__(
        self, prior: Prior, located: LocatedReadings, motion: State, solution: Solution
    ) -> None:
        self._prior, self._motion, self._from = prior, motion, solution
        process = located.parameters.process
        size = solution.state.numbers + process.size
        self._columns = [solution.state.numbers + column for column in delay_columns(process)]
        self._workspace, self._cholesky = solution.memory(size)
        self._linearize(solution.state, located)

    def _linearize(self, state: State, located: LocatedReadings) -> None:
        time, numbers = located.grid.time, state.numbers
        noise_state = self._from.equations.noise_state
        seen = linearize(self._prior, located, state, noise_state, self._workspace)
        own = motion_left(state, self._motion, time).reshape(time.size, -1)
        seen.rhs[:, self._columns] -= np.sum(own * seen.rhs[:, :numbers], axis=1)[:, None]
        self._seen = replace(seen, system=_moving_along(seen.system, own, self._columns))
        self._cholesky = factor(self._seen.system, self._cholesky)
        self._step = self._cholesky.solve(seen.rhs)
        self.length = float(np.sqrt(np.sum(self._step * seen.rhs)))

    def step(self) -> None:
        """Go on; what is left to go may grow before it shrinks, as the motion follows a delay."""
        of_nodes, of_parameters = self._seen.split(self._step)
        moved = self._seen.located.moved(of_parameters)
        self._linearize(self._seen.state.retract(of_nodes), moved)

    def solution(self) -> Solution:
        """The solution here."""
        seen, known = self._seen, self._from
        return replace(
            known, state=seen.state, located=seen.located, equations=seen, cholesky=self._cholesky
        )


def _shares(
    prior: Prior,
    moving: LocatedReadings,
    noise: Sequence[State],
    solution: Solution,
    late: set[str],
) -> dict[str, float]:
    """How much of the motion's slope each late stream can count on, where noise makes motion, too.

    A robot at rest is estimated to move by what noise makes of it, and such motion dates nothing.
    What it would tell of a delay is found by draws of the readings' noise, and taken off.
    """
    state, equations = solution.state, solution.equations
    workspace, cholesky = solution.memory(state.numbers + moving.parameters.process.size)
    held = linearize(prior, moving, state, equations.noise_state, workspace)
    columns = [state.numbers + c for c in delay_columns(moving.parameters.process)]
    held.system.diagonal[:, columns, columns] += _HELD
    cholesky = factor(held.system, cholesky)
    streams = [r for r in moving.streams if r.name in late]
    out = {}
    for stream in streams:
        own = locate(moving.grid, [stream], moving.parameters.process.each, keep_all=True)
        own = with_parameters(own, moving.parameters.by_name())
        told, *rest = (
            _told(prior, replace(own, motion=motion), solution, workspace, cholesky)
            for motion in (moving.motion, *noise)
        )
        numbers = len(stream) * stream.row_count
        out[stream.name] = share(told, float(np.mean(rest)), numbers)
    return out


def share(told: float, of_noise: float, numbers: float, deviations: float = 2.0) -> float:
    """How much of the motion's slope counts.

    Half the logarithm of the ratio of two sums of ν squares has a standard deviation of ν^-1/2: as
    many times of what noise tells are taken off. Source: Fisher's z.

    Args:
        told: What readings say of the delay, s⁻².
        of_noise: What nothing but noise would say.
        numbers: How many numbers that is from.
        deviations: Standard deviations of what noise tells by chance that are taken off.
    """
    if not told > 0.0:
        return 0.0
    margin = np.exp(2.0 * deviations / np.sqrt(max(numbers / _ALIKE, 1e-3)))
    return float(np.sqrt(max(1.0 - margin * of_noise / told, 0.0)))


def _told(
    prior: Prior, own: LocatedReadings, solution: Solution, workspace: Array, cholesky: Cholesky
) -> float:
    """What the readings of a stream tell of its delay by the motion, s⁻²."""
    process, state = own.parameters.process, solution.state
    columns = delay_columns(process)
    columns = [*columns, *(process.size + column for column in columns)]
    layout = Layout(own.grid.arclength.size, state.dof, process.size)
    builder, out = NormalEquationsBuilder.joined(layout, own.grid.time.size, workspace), 0.0
    noise_state = solution.equations.noise_state
    for _, _, batch in measurement_factors(prior, own, state, noise_state):
        if batch.extras is not None:
            slope = batch.extras[..., columns].sum(axis=-1)
            weights = batch.terms.robust_weights()
            out += float(np.sum(weights * np.sum(batch.terms.whiten(slope) ** 2, axis=1)))
            terms = replace(batch.terms, residual=slope)
            builder.accumulate(replace(batch, terms=terms), weights)
    rhs = builder.rhs_begin
    return out - float(np.sum(rhs * cholesky.solve(rhs)))


def _motion_of_noise(prior: Prior, shown: Solution, rng: np.random.Generator) -> State:
    """What noise of the readings alone would make a robot at rest seem to do."""
    located, state = shown.located, shown.state
    layout = Layout(located.grid.arclength.size, state.dof, located.parameters.process.size)
    builder = NormalEquationsBuilder.joined(layout, located.grid.time.size, shown.workspace)
    noise_state = shown.equations.noise_state
    for _, _, batch in measurement_factors(prior, located, state, noise_state):
        add_noise(builder, batch, batch.terms.robust_weights(), rng)
    step = shown.cholesky.solve(builder.rhs_begin)[:, : state.numbers]
    rest = prior.rest_state(located.grid).with_fields_of(state)
    return rest.retract(step.reshape(*state.strain.shape[:2], state.dof))


def add_noise(
    builder: NormalEquationsBuilder, batch: Factors, weights: Array, rng: np.random.Generator
) -> None:
    """Add readings as they would be if there were nothing but noise in them, with weights (M,)."""
    white = rng.standard_normal(batch.terms.residual.shape)
    noise = np.asarray(np.linalg.solve(batch.terms.sqrt_info, white[..., None])[..., 0])
    builder.accumulate(replace(batch, terms=replace(batch.terms, residual=noise)), weights)


def delayed(
    sensor_parameters: Sequence[SensorParameter],
) -> tuple[set[str], list[SensorParameter]]:
    """Names of the streams whose delay is estimated, and all parameters that are no such delay."""
    others = [p for p in sensor_parameters if not _is_delay(p)]
    return {name for p in sensor_parameters if _is_delay(p) for name in p.streams}, others


def delay_columns(process: EstimatedParameters) -> list[int]:
    """Which of the numbers of a time node's parameters are delays."""
    return [c.start for p, c in zip(process.each, process.columns, strict=True) if _is_delay(p)]


def delayed_streams(process: EstimatedParameters) -> list[str]:
    """Names of the streams whose delay is estimated."""
    return sorted({name for p in process.each if _is_delay(p) for name in p.streams})


def motion_left(state: State, motion: State, time: Array) -> Array:
    """∂(x − x₀)/∂t (K, N, dof) at the nodes `state` x, of which x₀ is the `motion`."""
    return slope_in_time(state, time) - slope_in_time(motion, time)


def at_times(state: State, nodes: Array, time: Array) -> State:
    """Nodes (K, N) at other times (M,): straight between two, held before, straight on after."""
    if nodes.size == 1:
        return state.take(np.zeros(time.size, dtype=int))
    lower = np.clip(np.searchsorted(nodes, time, side="right") - 1, 0, nodes.size - 2)
    start, step = state.take(lower), nodes[lower + 1] - nodes[lower]
    share = np.maximum(time - nodes[lower], 0.0) / step
    return start.retract(share[:, None, None] * state.take(lower + 1).difference(start))


def moving_with(factors: Factors, own: Array, columns: Sequence[int], size: int) -> Factors:
    """Factors of x′ by x = x′ + c d.

    Args:
        factors: Linearised at the nodes (K, N), in order of time.
        own: c (K, N, dof) of those nodes.
        columns: Which parameters are delays.
        size: How many numbers all parameters have.
    """
    m, r = factors.jacobian.shape[:2]
    k, n = np.divmod(factors.nodes, own.shape[1])
    by_node = np.einsum("mrcd,mcd->mcr", factors.jacobian, own[k, n][..., factors.dofs])
    extras = np.zeros((m, r, 2, size))
    if factors.extras is not None:
        extras += factors.extras.reshape(extras.shape)
    first = np.minimum(k[:, :1], max(len(own) - 2, 0))  # the interval in which the solver puts them
    for end in range(2):
        by_delay = np.sum(by_node * (k - first == end)[..., None], axis=1)
        extras[:, :, end, columns] -= by_delay[..., None]
    return replace(factors, extras=extras.reshape(m, r, -1))


def _is_delay(parameter: SensorParameter) -> bool:
    return parameter.kind == "time_offset" and not parameter.known


def slope_in_time(state: State, time: Array) -> Array:
    """Slope (K, N, dof) of nodes along time, between their neighbours."""
    if time.size == 1:  # no motion is seen
        return np.zeros((*state.pose.shape[:2], state.dof))
    k = np.arange(time.size)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, time.size - 1)
    step = time[after] - time[before]
    return state.take(after).difference(state.take(before)) / step[:, None, None]


def _moving_along(system: BlockTridiagonal, own: Array, columns: list[int]) -> BlockTridiagonal:
    """The system of x′ by x = x′ + c d, in place: c `own` (K, n) of the first n numbers of a slab.

    Args:
        system: The system (K slabs) of x.
        own: c.
        columns: Which numbers of a slab are delays.
    """
    n, slabs = own.shape[1], ((system.diagonal, own, own), (system.lower, own[1:], own[:-1]))
    for blocks, of_rows, of_columns in slabs:
        blocks[:, :, columns] -= blocks[:, :, :n] @ of_columns[:, :, None]
        blocks[:, columns] -= of_rows[:, None] @ blocks[:, :n]
    return system
