"""Arclength offsets of sensors at the mode of their evidence, with the states marginalised.

The joint mode of states and an unknown arclength offset differs from the mode of the offset alone.
Readings nearer to the tip explain the same displacement with less bending, so the joint cost
falls towards the tip with every independent shape, while the offset's variance shrinks. It is
balanced by ½ log|A| of the system, which depends on the offset and which Gauss–Newton steps omit.
Its derivative enters as a shift of the offset's prior mean, computed again until it is that at the
solution. Source: equation (22).

A prior broader than the robot's motion would shift the offset towards the base as strongly, since
readings are smaller than it expects. So the derivative is scaled by the ratio of the prior's cost
to its expectation, as if the prior's scale were unknown: the size of motions then has no influence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from glissando.estimation.slope_share import rhs_of_noise
from glissando.geometry.se3 import Array
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import EstimatedParameters
from glissando.model.sensors.parameters import SensorParameter
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.gauss_newton import Solution
from glissando.solver.linearize import linearize

_ROUNDS = 6  # of computing derivatives and solving again
_DRAWS = 2  # of noise, for the number of directions that readings determine
_NUDGE = 0.2  # standard deviations of an offset: step of the finite differences
_SETTLED = 0.1  # standard deviations of an offset: largest last change when it has converged

Solve = Callable[[Sequence[SensorParameter], Solution], Solution]
"""Solves with other sensor parameters, started from a solution."""


def by_evidence(
    prior: Prior, solution: Solution, given: Sequence[SensorParameter], solve: Solve
) -> Solution:
    """Solution in which constant arclength offsets are at the mode of their evidence.

    Args:
        prior: The prior.
        solution: Solution at the joint mode of states and parameters.
        given: Sensor parameters with their stated priors.
        solve: Solves with other priors of the parameters.
    """
    process = solution.located.parameters.process
    columns = _offsets(process)
    if not columns:
        return solution
    shift, at_mode = np.zeros(len(columns)), solution
    for _ in range(_ROUNDS):
        cholesky = factor(at_mode.equations.system)
        slope, std = _slopes(prior, at_mode, columns, cholesky)
        slope *= _prior_cost_ratio(prior, at_mode, cholesky)
        change, shift = slope - shift, slope
        if np.all(np.abs(change) * std < _SETTLED):
            break
        expected = process.mean.copy()
        expected[columns] -= process.std[columns] ** 2 * shift
        moved = {p.name: expected[at] for p, at in zip(process.each, process.columns, strict=True)}
        at_mode = solve([replace(p, value=moved.get(p.name, p.value)) for p in given], at_mode)
    return at_mode if at_mode is solution else _as_stated(at_mode, process)


def _offsets(process: EstimatedParameters) -> list[int]:
    """Columns of a time node's parameters that are constant arclength offsets."""
    pairs = zip(process.each, process.columns, strict=True)
    return [
        column
        for parameter, at in pairs
        if parameter.moves
        and parameter.along == "arclength"
        and np.isinf(parameter.correlation_time)
        for column in range(at.start, at.stop)
    ]


def _slopes(
    prior: Prior, solution: Solution, columns: list[int], cholesky: Cholesky
) -> tuple[Array, Array]:
    """Derivatives (P,) of −log evidence by offsets, states at their best; offsets' std (P,)."""
    at, paths = solution.equations, []
    rows = [at.state.numbers + column for column in columns]
    for row in rows:
        unit = np.zeros_like(at.rhs)
        unit[0, row] = 1.0
        paths.append(cholesky.solve(unit))
    along = np.stack(paths, axis=-1)
    along, std = along @ np.linalg.inv(along[0, rows]), np.sqrt(np.diagonal(along[0, rows]))
    slopes = np.empty(len(columns))
    for i, nudge in enumerate(_NUDGE * std):
        ends = [_minus_evidence(prior, solution, way * along[..., i]) for way in (nudge, -nudge)]
        slopes[i] = (ends[0] - ends[1]) / (2.0 * nudge)
    return slopes, std


def _prior_cost_ratio(prior: Prior, solution: Solution, cholesky: Cholesky) -> float:
    """Ratio of the prior's cost to its expectation: about 1 where the prior is right.

    It is twice the cost over the number of directions of the states that readings determine.
    """
    at = solution.equations
    actual = 2.0 * sum(terms.cost(terms.residual) for terms in at.prior_terms())
    expected, rng = 0.0, np.random.default_rng(0)
    for _ in range(_DRAWS):
        rhs = rhs_of_noise(prior, solution.located, (at.state, at.noise_state), rng)
        expected += float(np.sum(rhs * cholesky.solve(rhs))) / _DRAWS
    return actual / expected


def _minus_evidence(prior: Prior, solution: Solution, step: Array) -> float:
    """Negative log evidence, up to a constant, a step (K, D) away from a solution."""
    of_nodes, of_parameters = solution.equations.split(step)
    state, located = solution.state.retract(of_nodes), solution.located.moved(of_parameters)
    stepped = linearize(prior, located, state, state)
    return stepped.cost_of(stepped) + 0.5 * (stepped.log_det_noise + factor(stepped.system).log_det)


def _as_stated(solution: Solution, process: EstimatedParameters) -> Solution:
    """The solution with the stated prior means of sensor parameters, its cost corrected."""
    parameters = replace(solution.located.parameters, process=process)
    shifted, values = solution.located.parameters.process.mean, parameters.values[0]
    cost = np.sum(((values - process.mean) ** 2 - (values - shifted) ** 2) / process.std**2)
    located = replace(solution.located, parameters=parameters)
    return replace(solution, located=located, cost=solution.cost + 0.5 * float(cost))
