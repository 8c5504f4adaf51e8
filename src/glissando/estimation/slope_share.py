"""Share of an estimated motion's slope that is motion, and not an effect of the readings' noise.

Noise of the readings moves any estimate, and where the shape may bend freely between sensors it
contributes most of the information of slopes on a delay. With s the slopes of readings in time and
S their covariance with delays fixed, that information is sᵀS⁻¹s. That of drawn noise is subtracted,
and nothing counts where noise alone may explain it by chance.
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

_ALIKE = 6.0  # scalar readings per independent square, from the scatter of draws of noise


def shares_of_slope(
    prior: Prior,
    moving: LocatedReadings,
    noise: Sequence[State],
    solution: Solution,
    late: Collection[str],
    delays: Sequence[int],
) -> dict[str, float]:
    """Share of the motion's slope that counts for each delayed stream, by its name.

    Args:
        prior: The prior.
        moving: The readings, with the motion that dates delays.
        noise: Draws of the apparent motion of a robot at rest, see `motion_of_noise`.
        solution: Solution from all readings; its memory is overwritten.
        late: Names of the streams with a delay.
        delays: Columns of the sensor parameters that are delays.
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
    """Share of the motion's slope that counts: the part above noise, where that is significant.

    Half the logarithm of the ratio of two sums of ν squares has a standard deviation of ν^-1/2.
    Source: Fisher's z.

    Args:
        of_motion: Information of the readings on the delay, s⁻².
        of_noise: Mean of the same for pure noise, s⁻².
        numbers: Number of scalar readings.
        deviations: Standard deviations by which the first has to exceed the second.
    """
    chance = np.exp(2.0 * deviations / np.sqrt(max(numbers / _ALIKE, 1e-3)))
    of_noise = max(of_noise, 0.0)  # negative only by rounding
    return float(np.sqrt(1.0 - of_noise / of_motion)) if of_motion > chance * of_noise else 0.0


def _information_of_motion(
    prior: Prior,
    own: LocatedReadings,
    solution: Solution,
    delays: Sequence[int],
    cholesky: Cholesky,
) -> float:
    """Information of a stream's readings on its delay, given a motion, s⁻²."""
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
    """Apparent motion of a robot at rest, estimated from drawn noise of the readings."""
    located, state = shown.located, shown.state
    rhs = rhs_of_noise(prior, located, (state, shown.equations.noise_state), rng)
    step = shown.cholesky.solve(rhs)[:, : state.numbers]
    rest = prior.rest_state(located.grid).with_fields_of(state)
    return rest.retract(step.reshape(*state.strain.shape[:2], state.dof))


def rhs_of_noise(
    prior: Prior, located: LocatedReadings, states: tuple[State, State], rng: np.random.Generator
) -> Array:
    """Right-hand side (K, D) of readings at states if their residuals were drawn noise."""
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
    """Add readings with drawn noise for residuals, and weights (M,)."""
    white = rng.standard_normal(batch.terms.residual.shape)
    noise = np.asarray(np.linalg.solve(batch.terms.sqrt_info, white[..., None])[..., 0])
    sums.accumulate(replace(batch, terms=replace(batch.terms, residual=noise)), weights)
