"""How much of a motion's slope is motion: what noise of readings alone makes a robot seem to do.

A robot is always estimated to move by what noise makes of it, and where its shape may bend freely
between sensors, noise tells most of what such slopes tell of a delay. With s the slopes of readings
by the time they were taken and S their covariance while delays are held, that is sᵀS⁻¹s. The same
of drawn noise is taken off, and nothing counts where it may be noise by chance.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from glissando.estimation.starting_point import with_parameters
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.priors.prior import Prior
from glissando.model.sensors.parameter_process import HELD
from glissando.model.state import State
from glissando.solver.block_tridiagonal import Cholesky, factor
from glissando.solver.gauss_newton import Solution
from glissando.solver.linearize import layout_of, linearize
from glissando.solver.located_readings import LocatedReadings, locate
from glissando.solver.measurement_factors import measurement_factors
from glissando.solver.normal_equations import Gradient, NormalEquationsBuilder

_ALIKE = 6.0  # numbers of readings that vary as one square, by how much draws of noise differ


def shares_of_slope(
    prior: Prior,
    moving: LocatedReadings,
    noise: Sequence[State],
    solution: Solution,
    late: Collection[str],
    delays: Sequence[int],
) -> dict[str, float]:
    """How much of the motion's slope each late stream can count on.

    Args:
        prior: The prior.
        moving: The readings, with the motion by which delays are seen.
        noise: Draws of what noise would make a robot at rest seem to do, see `motion_of_noise`.
        solution: The estimate from all readings; its memory is overwritten.
        late: Names of the streams with a delay.
        delays: Which numbers of the sensor parameters are delays.
    """
    state, process = solution.state, moving.parameters.process
    workspace, cholesky = solution.memory(state.numbers + process.size)
    held = linearize(prior, moving, state, solution.equations.noise_state, workspace)
    columns = [state.numbers + delay for delay in delays]
    held.system.diagonal[:, columns, columns] += HELD
    cholesky = factor(held.system, cholesky)
    out = dict.fromkeys(late, 0.0)
    for stream in moving.streams:
        if stream.name in late:
            own = locate(moving.grid, [stream], process.each, keep_all=True)
            own = with_parameters(own, moving.parameters.by_name())
            of_motion, *of_noise = (
                _information_of_motion(
                    prior, replace(own, motion=motion), solution, delays, cholesky
                )
                for motion in (moving.motion, *noise)
            )
            numbers = len(stream) * stream.row_count
            out[stream.name] = share(of_motion, float(np.mean(of_noise)), numbers)
    return out


def share(of_motion: float, of_noise: float, numbers: float, deviations: float = 2.0) -> float:
    """How much of the motion's slope counts: all but noise, where it tells more than by chance.

    Half the logarithm of the ratio of two sums of ν squares has a standard deviation of ν^-1/2.
    Source: Fisher's z.

    Args:
        of_motion: What readings say of the delay, s⁻².
        of_noise: What nothing but noise would say.
        numbers: How many numbers of readings that is from.
        deviations: Standard deviations by which it has to exceed what noise would say.
    """
    chance = np.exp(2.0 * deviations / np.sqrt(max(numbers / _ALIKE, 1e-3)))
    of_noise = max(of_noise, 0.0)  # but for rounding
    return float(np.sqrt(1.0 - of_noise / of_motion)) if of_motion > chance * of_noise else 0.0


def _information_of_motion(
    prior: Prior,
    own: LocatedReadings,
    solution: Solution,
    delays: Sequence[int],
    cholesky: Cholesky,
) -> float:
    """What the readings of a stream tell of its delay by the motion, s⁻²."""
    process, state = own.parameters.process, solution.state
    columns, out = [*delays, *(process.size + column for column in delays)], 0.0
    sums = Gradient(layout_of(own, state), own.grid.time.size)
    for _, _, batch in measurement_factors(prior, own, state, solution.equations.noise_state):
        if batch.extras is not None:
            slope = batch.extras[..., columns].sum(axis=-1)
            weights = batch.terms.robust_weights()
            out += float(np.sum(weights * np.sum(batch.terms.whiten(slope) ** 2, axis=1)))
            terms = replace(batch.terms, residual=slope)
            sums.accumulate(replace(batch, terms=terms), weights)
    return out - float(np.sum(sums.rhs * cholesky.solve(sums.rhs)))


def motion_of_noise(prior: Prior, shown: Solution, rng: np.random.Generator) -> State:
    """What noise of the readings alone would make a robot at rest seem to do."""
    located, state = shown.located, shown.state
    rhs = rhs_of_noise(prior, located, (state, shown.equations.noise_state), rng)
    step = shown.cholesky.solve(rhs)[:, : state.numbers]
    rest = prior.rest_state(located.grid).with_fields_of(state)
    return rest.retract(step.reshape(*state.strain.shape[:2], state.dof))


def rhs_of_noise(
    prior: Prior, located: LocatedReadings, states: tuple[State, State], rng: np.random.Generator
) -> Array:
    """What readings at states would have on the right (K, D) were nothing but noise in them."""
    sums = Gradient(layout_of(located, states[0]), located.grid.time.size)
    for _, _, batch in measurement_factors(prior, located, *states):
        add_noise(sums, batch, batch.terms.robust_weights(), rng)
    return sums.rhs


def add_noise(
    sums: NormalEquationsBuilder | Gradient,
    batch: Factors,
    weights: Array,
    rng: np.random.Generator,
) -> None:
    """Add readings as they would be if there were nothing but noise in them, with weights (M,)."""
    white = rng.standard_normal(batch.terms.residual.shape)
    noise = np.asarray(np.linalg.solve(batch.terms.sqrt_info, white[..., None])[..., 0])
    sums.accumulate(replace(batch, terms=replace(batch.terms, residual=noise)), weights)
