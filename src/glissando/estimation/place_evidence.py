"""Where readings were taken along the robot, by evidence: the states count with all they may be.

The joint mode of states and an unknown offset along the robot is not the offset's own mode.
Readings that lie farther out explain the same displacement with less bending, so the joint cost
falls towards the tip with every independent shape, while the offset's variance shrinks. What
balances this is ½ log|A| of the system, which answers to the offset and which Gauss–Newton steps
leave out. Its slope enters as a shift of what is expected of the offset, found again until it is
that of where the iteration ends. Source: equation (22).

A prior broader than what the robot does would push inwards as strongly, since readings are smaller
than it expects. So the slope counts as much as the prior's cost is of what is expected of it, as if
the scale of the prior were unknown: the offset is then not found from how large motions are.
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

_ROUNDS = 6  # of finding slopes and solving again
_DRAWS = 2  # of noise, for what readings tell of the states
_NUDGE = 0.2  # standard deviations of an offset, for differences
_SETTLED = 0.1  # standard deviations by which the last shift still moves an offset

Solve = Callable[[Sequence[SensorParameter], Solution], Solution]
"""The solution with other sensor parameters, from where another ended."""


def by_evidence(
    prior: Prior, solution: Solution, given: Sequence[SensorParameter], solve: Solve
) -> Solution:
    """A solution in which constant offsets along the robot have the mode of their evidence.

    Args:
        prior: The prior.
        solution: Where the iteration ended.
        given: The sensor parameters as they are stated.
        solve: Solves again.
    """
    process = solution.located.parameters.process
    columns = _offsets(process)
    if not columns:
        return solution
    push, at_mode = np.zeros(len(columns)), solution
    for _ in range(_ROUNDS):
        cholesky = factor(at_mode.equations.system)
        slope, std = _slopes(prior, at_mode, columns, cholesky)
        slope *= _activity(prior, at_mode, cholesky)
        change, push = slope - push, slope
        if np.all(np.abs(change) * std < _SETTLED):
            break
        expected = process.mean.copy()
        expected[columns] -= process.std[columns] ** 2 * push
        moved = {p.name: expected[at] for p, at in zip(process.each, process.columns, strict=True)}
        at_mode = solve([replace(p, value=moved.get(p.name, p.value)) for p in given], at_mode)
    return at_mode if at_mode is solution else _as_stated(at_mode, process)


def _offsets(process: EstimatedParameters) -> list[int]:
    """Which numbers of a time node's parameters are constant offsets along the robot."""
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
    """Slopes (P,) of minus the log evidence by offsets, states following; the offsets' std (P,)."""
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


def _activity(prior: Prior, solution: Solution, cholesky: Cholesky) -> float:
    """How much of what the prior expects the states do: about 1 where it is right.

    Twice the prior's cost, over the number of directions in the states of which readings tell.
    """
    at = solution.equations
    done = 2.0 * sum(terms.cost(terms.residual) for terms in at.prior_terms())
    expected, rng = 0.0, np.random.default_rng(0)
    for _ in range(_DRAWS):
        rhs = rhs_of_noise(prior, solution.located, (at.state, at.noise_state), rng)
        expected += float(np.sum(rhs * cholesky.solve(rhs))) / _DRAWS
    return done / expected


def _minus_evidence(prior: Prior, solution: Solution, step: Array) -> float:
    """Minus the log evidence, up to a constant, a step (K, D) away from a solution."""
    of_nodes, of_parameters = solution.equations.split(step)
    state, located = solution.state.retract(of_nodes), solution.located.moved(of_parameters)
    stepped = linearize(prior, located, state, state)
    return stepped.cost_of(stepped) + 0.5 * (stepped.log_det_noise + factor(stepped.system).log_det)


def _as_stated(solution: Solution, process: EstimatedParameters) -> Solution:
    """The solution with sensor parameters that are expected where they are stated."""
    parameters = replace(solution.located.parameters, process=process)
    shifted, values = solution.located.parameters.process.mean, parameters.values[0]
    cost = np.sum(((values - process.mean) ** 2 - (values - shifted) ** 2) / process.std**2)
    located = replace(solution.located, parameters=parameters)
    return replace(solution, located=located, cost=solution.cost + 0.5 * float(cost))
