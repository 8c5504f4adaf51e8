"""Estimation of delays from the motion that streams without an estimated delay determine.

Where all streams share a delay, a later motion explains their readings as well as this one, since
the prior is the same at all times. Gauss–Newton steps omit the curvature of the residuals and with
it this ambiguity, and would determine the delay from the motion that its own readings gave. So a
delay is estimated from the motion x₀ of the streams without one, and the rest of the motion,
x − x₀, moves with it: with c = ∂(x − x₀)/∂t at the nodes, x = x′ + c d, and d enters the readings
by ∂x₀/∂t alone. Streams that each have a delay of their own do not date one another. Noise makes
the estimate move as well; the information on a delay from that is subtracted: see `slope_share`.
Online, x₀ is that of a second smoother, without the delayed streams: see `delay_dating`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from glissando.errors import UnobservableError
from glissando.estimation.slope_share import motion_of_noise, shares_of_slope
from glissando.estimation.starting_point import with_parameters
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.model.state import State
from glissando.solver.block_tridiagonal import BlockTridiagonal, Cholesky, factor
from glissando.solver.gauss_newton import Solution, SolverOptions, Stopwatch, minimize
from glissando.solver.linearize import NormalEquations, linearize
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.outcome import Outcome

_DRAWS = 4  # of noise, for the information on a delay that it would give
_STEPS = 15  # most steps in which delays converge
_MOTION = 0.03  # error allowed in the motion that dates delays, standard deviations per unknown


def with_unseen_delays(
    prior: Prior,
    solution: Solution,
    sensor_parameters: Sequence[SensorParameter],
    options: SolverOptions,
) -> Solution:
    """Solution in which delays are estimated from the motion of streams without a delay.

    Args:
        prior: The prior.
        solution: Solution of the joint problem; its memory is overwritten.
        sensor_parameters: Parameters of the sensors.
        options: Stopping criteria of the estimate from the streams without a delay.

    Returns:
        The solution with other delays and another information matrix, if a delay is estimated;
        else the same.
    """
    process = solution.located.parameters.process
    delays = process.delay_columns
    if not delays:
        return solution
    late, others = delayed(sensor_parameters)
    streams = [r for r in solution.located.streams if r.name not in late]
    grid, state = solution.located.grid, solution.state
    motion, shares = prior.rest_state(grid), dict.fromkeys(late, 0.0)
    if streams:
        with suppress(UnobservableError, np.linalg.LinAlgError):  # these determine no motion
            values = solution.located.parameters.by_name()
            alone = with_parameters(locate(grid, streams, others), values)
            rough = options.rougher(state.pose.shape[0] * state.numbers, _MOTION)
            shown = minimize(prior, alone, state, rough, None, Stopwatch(), solution)
            rng = np.random.default_rng(0)
            noise = [motion_of_noise(prior, shown, rng) for _ in range(_DRAWS)]
            motion = shown.state
            moving = replace(solution.located, motion=motion)
            shares = shares_of_slope(prior, moving, noise, solution, late, delays)
    located = replace(solution.located, motion=motion)
    return _iterate_delays(prior, located, shares, solution, options)


def _iterate_delays(
    prior: Prior,
    located: LocatedReadings,
    shares: Mapping[str, float],
    solution: Solution,
    options: SolverOptions,
) -> Solution:
    """Iterate steps in which only the motion x₀ determines delays.

    The least cost would shift readings between those of other streams, where a flexible motion
    contradicts them least, whatever their delay is. Where the motion gives no information, or steps
    do not converge, delays are as stated, and as uncertain.
    """
    zero_shares = dict.fromkeys(shares, 0.0)
    for counted in (shares, zero_shares) if any(shares.values()) else (zero_shares,):
        converged = _converged_steps(prior, located, counted, solution, options)
        if converged is not None:
            return converged
    seen, cholesky = _equations_by_motion(prior, located, zero_shares, solution.state, solution)
    return replace(solution, equations=seen, cholesky=cholesky)


def _converged_steps(
    prior: Prior,
    located: LocatedReadings,
    shares: Mapping[str, float],
    solution: Solution,
    options: SolverOptions,
) -> Solution | None:
    """Solution to which these steps converge, or None if they do not."""
    state, at = solution.state, located
    for _ in range(_STEPS):
        seen, cholesky = _equations_by_motion(prior, at, shares, state, solution)
        step = cholesky.solve(seen.rhs)
        length = float(np.sqrt(np.sum(step * seen.rhs)))  # may grow before it shrinks
        if length < options.tolerance:
            settled = replace(solution, state=state, located=at, equations=seen, cholesky=cholesky)
            ended = Outcome.CONVERGED
            return replace(settled, cost=seen.cost_of(seen), outcome=ended, last_step=length)
        of_nodes, of_parameters = seen.split(step)
        state, at = state.retract(of_nodes), at.moved(of_parameters)
    return None


def _equations_by_motion(
    prior: Prior,
    located: LocatedReadings,
    shares: Mapping[str, float],
    state: State,
    solution: Solution,
) -> tuple[NormalEquations, Cholesky]:
    """Normal equations with delays by x₀ alone, and their factor, in the memory of a solution."""
    process, time = located.parameters.process, located.grid.time
    workspace, cholesky = solution.memory(state.numbers + process.size)
    located, counts = _with_shares(located, shares)
    equations = linearize(prior, located, state, state, workspace)
    own = slope_in_time(state, time)
    if located.motion is not None:
        own -= slope_in_time(located.motion, time)
    own = own.reshape(time.size, -1)
    columns = [state.numbers + column for column in process.delay_columns]
    equations.rhs[:, columns] -= np.sum(own * equations.rhs[:, : state.numbers], axis=1)[:, None]
    cholesky = factor(_moving_along(equations.system, own, columns), cholesky)
    if np.all(counts == 1.0):
        return equations, cholesky
    return equations, _factor_with_shares(equations, counts, columns, cholesky)


def _with_shares(
    located: LocatedReadings, shares: Mapping[str, float]
) -> tuple[LocatedReadings, Array]:
    """Readings with full slopes, and the share of the slope of each delay (d,) that counts.

    A delay that drifts differs from node to node; slopes of its streams are scaled instead.
    """
    delays = [p for p in located.parameters.process.each if is_delay(p)]
    drifting = {n for p in delays if np.isfinite(p.correlation_time) for n in p.streams}
    counts = [
        1.0 if drifting.intersection(p.streams) else min(shares.get(n, 1.0) for n in p.streams)
        for p in delays
    ]
    scaled = {name: share for name, share in shares.items() if name in drifting}
    return replace(located, shares=scaled), np.array(counts)


def _factor_with_shares(
    equations: NormalEquations, counts: Array, columns: Sequence[int], cholesky: Cholesky
) -> Cholesky:
    """Factor of the normal equations in which a share of the slope of each delay (d,) counts.

    Readings with scaled slopes would determine states as well as if delays were certain. So the
    states given the delays are kept, and the information from noise is subtracted from the delays
    alone, for which both are equivalent.
    """
    process = equations.located.parameters.process
    node = len(equations.rhs) // 2  # any, as delays are constant
    cov, unit = np.zeros((len(columns), len(columns))), np.zeros_like(equations.rhs)
    for row, column in enumerate(columns):
        unit[node, column] = 1.0
        cov[row] = cholesky.solve(unit)[node, columns]
        unit[node, column] = 0.0
    info = np.linalg.inv(0.5 * (cov + cov.T))
    off = (process.mean - equations.located.parameters.values[node])[process.delay_columns]
    stated = np.diag(process.std[process.delay_columns] ** -2.0)
    data_info = info - stated
    data_rhs = info @ cholesky.solve(equations.rhs)[node, columns] - stated @ off
    change = counts[:, None] * data_info * counts - data_info
    equations.system.diagonal[np.ix_([node], columns, columns)] += change
    equations.rhs[node, columns] += counts * data_rhs - data_rhs
    return factor(equations.system, cholesky)


def delayed(
    sensor_parameters: Sequence[SensorParameter],
) -> tuple[set[str], list[SensorParameter]]:
    """Names of the streams whose delay is estimated, and all parameters but these delays."""
    others = [p for p in sensor_parameters if not is_delay(p)]
    return {name for p in sensor_parameters if is_delay(p) for name in p.streams}, others


def delayed_streams(process: EstimatedParameters) -> list[str]:
    """Names of the streams whose delay is estimated."""
    return sorted({name for p in process.each if is_delay(p) for name in p.streams})


def at_times(state: State, nodes: Array, time: Array) -> State:
    """Nodes (K, N) at other times (M,): linear between two, constant before, extrapolated after."""
    if nodes.size == 1:
        return state.take(np.zeros(time.size, dtype=int))
    lower = np.clip(np.searchsorted(nodes, time, side="right") - 1, 0, nodes.size - 2)
    start, step = state.take(lower), nodes[lower + 1] - nodes[lower]
    share = np.maximum(time - nodes[lower], 0.0) / step
    return start.retract(share[:, None, None] * state.take(lower + 1).difference(start))


def moving_with(factors: Factors, own: Array, columns: Sequence[int], size: int) -> Factors:
    """Factors of x′ by x = x′ + c d.

    Args:
        factors: Factors linearised at the nodes (K, N), in order of time.
        own: Derivatives c (K, N, dof) of these nodes.
        columns: Columns of the parameters that are delays.
        size: Number of unknowns of all parameters.
    """
    m, r = factors.jacobian.shape[:2]
    k, n = np.divmod(factors.nodes, own.shape[1])
    by_node = np.einsum("mrcd,mcd->mcr", factors.jacobian, own[k, n][..., factors.dofs])
    extras = np.zeros((m, r, 2, size))
    if factors.extras is not None:
        extras += factors.extras.reshape(extras.shape)
    first = np.minimum(k[:, :1], max(len(own) - 2, 0))  # the interval that the solver assigns
    for end in range(2):
        by_delay = np.sum(by_node * (k - first == end)[..., None], axis=1)
        extras[:, :, end, columns] -= by_delay[..., None]
    return replace(factors, extras=extras.reshape(m, r, -1))


def is_delay(parameter: SensorParameter) -> bool:
    """Whether a parameter is a delay that is estimated."""
    return parameter.kind == "time_offset" and not parameter.known


def slope_in_time(state: State, time: Array) -> Array:
    """Slope (K, N, dof) of nodes in time, by differences of their neighbours."""
    if time.size == 1:  # there is no motion
        return np.zeros((*state.pose.shape[:2], state.dof))
    k = np.arange(time.size)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, time.size - 1)
    step = time[after] - time[before]
    return state.take(after).rise_from(state.take(before)) / step[:, None, None]


def _moving_along(system: BlockTridiagonal, own: Array, columns: list[int]) -> BlockTridiagonal:
    """System of x′ by x = x′ + c d, in place.

    Args:
        system: The system (K slabs) of x.
        own: Derivatives c (K, n) of the first n unknowns of each slab.
        columns: Columns of a slab that are delays.
    """
    n, slabs = own.shape[1], ((system.diagonal, own, own), (system.lower, own[1:], own[:-1]))
    for blocks, of_rows, of_columns in slabs:
        blocks[:, :, columns] -= blocks[:, :, :n] @ of_columns[:, :, None]
        blocks[:, columns] -= of_rows[:, None] @ blocks[:, :n]
    return system
