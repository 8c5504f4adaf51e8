"""Place and size of a contact force, with the whole nonlinear problem solved at every step.

Source: equation (29).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import FalseConfidenceWarning, OutsideGridError, UnobservableError
from glissando.estimation.batch import estimate
from glissando.estimation.contact import force_variance
from glissando.estimation.contact_force import Wrench, wrench_at
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, with_places
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.quantiles import chi_square_exceedance
from glissando.model.sensors.readings import Readings

_ROUNDS = 8
_MISFIT = 5.0  # standard deviations of the readings' misfit beyond which other starts are tried
_WORSE = 1.0  # increase in cost that is accepted, as a moment stands for an error of the place
_OTHERS = chi_square_exceedance(1e-3, 2)  # limit on the squared misfit of one force alone
_OF_OTHERS = (
    "No single force explains the readings: the likeliest, at {:.3g} m, leaves a squared misfit of "
    "{:.3g}, where chance leaves 2. Several touch the robot, or a moment acts, so place and force "
    "are wrong by more than is stated: name where they may act in `points` of the prior."
)
_STARTS = (0.15, 0.4, 0.65, 0.9)  # shares of the length
_LEVER = 0.1  # share of the length by which a place may be wrong during the search


@dataclass(frozen=True)
class Contact:
    """Estimate of a contact force on the robot.

    Attributes:
        arclength: Arclength of the force, m.
        std_arclength: Standard deviation of the arclength, m.
        force: Force (3,), N, in the world frame.
        cov_force: Covariance (3, 3) of the force, its place being uncertain.
        posterior: Posterior with this force, and a moment that stands for the error of its place.
    """

    arclength: float
    std_arclength: float
    force: Array
    cov_force: Array
    posterior: Posterior


def locate_contact(
    prior: MechanicalPrior,
    grid: Grid,
    readings: Sequence[Readings],
    *,
    start: float,
    std_force: ArrayLike | None = None,
) -> Contact:
    """Estimate place and size of one force, with the whole problem solved at every step.

    A force displaced by Δs has the moment Δs t × f at its former place, from which Gauss–Newton
    finds the displacement. One force alone is assumed: where several act, or a moment, the result
    is none of them.

    Args:
        prior: The prior, without the contact.
        grid: Nodes; the force is that at the last time.
        readings: Readings of each sensor.
        start: Arclength at which the search starts, m, as from a scan.
        std_force: Prior standard deviation of a force, N, as in `scan_contacts`.

    Raises:
        OutsideGridError: The start is not on the robot.

    Warns:
        FalseConfidenceWarning: No single force explains the readings.
    """
    length = float(grid.arclength[-1])
    if not 0.0 < start <= length:
        raise OutsideGridError(
            f"A contact at {start:g} m is off the robot of {length:g} m; give metres."
        )
    of_force = force_variance(prior, grid.arclength, std_force)
    of_moment = np.full(3, (_LEVER * length) ** 2 * of_force.max())
    variance = np.concatenate([of_force, of_moment])
    count = sum(len(r) * r.row_count for r in readings)
    best, reach = _solve_with_load(prior, grid, readings, start, variance), 0.15 * length
    if 2.0 * best.posterior.solve.cost > count + _MISFIT * np.sqrt(2.0 * count):
        for share in _STARTS:
            with suppress(UnobservableError):  # so far off that rounding errors dominate
                other = _solve_with_load(prior, grid, readings, share * length, variance)
                best = min(best, other, key=lambda touched: touched.posterior.solve.cost)
    for _ in range(_ROUNDS):
        if abs(best.move) < 0.1 * best.std + 1e-4 * length:
            break
        place = best.place + float(np.clip(best.move, -reach, reach))
        other = _solve_with_load(prior, grid, readings, place, variance, best.posterior)
        reach = 0.5 * abs(other.place - best.place)
        if reach < 1e-4 * length:
            break
        if other.posterior.solve.cost < best.posterior.solve.cost + _WORSE:
            best, reach = other, max(reach, 0.5 * abs(best.move))
    found = Contact(*best.wrench.over_places(best.place, length), best.posterior)
    misfit = best.wrench.beside_one_force(best.place, length)
    if misfit > _OTHERS:
        doubt = _OF_OTHERS.format(found.arclength, misfit)
        warnings.warn(doubt, FalseConfidenceWarning, stacklevel=2)
    for said in best.said:
        warnings.warn(said, stacklevel=2)
    return found


@dataclass(frozen=True)
class _Trial:
    """A load tried at a place, the wrench there, and the distance to the force beyond it."""

    posterior: Posterior
    place: float
    wrench: Wrench
    move: float
    std: float
    said: Sequence[Warning]


def _solve_with_load(
    prior: MechanicalPrior,
    grid: Grid,
    readings: Sequence[Readings],
    place: float,
    variance: Array,
    near_by: Posterior | None = None,
) -> _Trial:
    """Estimate with a load of this `variance` (6,) at a place, started from one nearby."""
    length, near = float(grid.arclength[-1]), 0.25 * float(np.diff(grid.arclength).min())
    place = float(np.clip(place, near, length - near))
    others = grid.arclength[np.abs(grid.arclength - place) > near]
    others = with_places(np.append(others, place), np.append(prior.joints, [0.0, length]))
    finer = Grid(others, grid.time, grid.before)
    order = np.argsort(np.append(prior.points, place))
    touched = replace(
        prior,
        points=np.append(prior.points, place)[order],
        var_points=np.concatenate([prior.var_points, variance[None]])[order],
    )
    start = None if near_by is None else near_by.states_on(finer)
    with warnings.catch_warnings(record=True) as caught:  # issued only for the place that is found
        warnings.simplefilter("always")
        posterior = estimate(touched, finer, readings, initial=start)
    wrench = wrench_at(posterior, place, variance)
    warned = [w.message for w in caught if isinstance(w.message, Warning)]
    return _Trial(posterior, place, wrench, *wrench.beyond(length), warned)
