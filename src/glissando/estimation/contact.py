"""Where something touches the robot: a scan for a single force, and its place found exactly.

A force at s_c adds G f to the error r of the interval it lies in. With the states marginalised it
has information B = Gᵀ(Q⁻¹ − Q⁻¹ P_r Q⁻¹)G and vector b = GᵀQ⁻¹r̂, so that log evidence grows by
½ bᵀ(B + Σ⁻¹)⁻¹b − ½ log det(1 + ΣB). Source: equation (29).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from glissando.errors import OutsideGridError, UnobservableError
from glissando.estimation.batch import estimate
from glissando.estimation.loads import require_mechanics
from glissando.estimation.posterior import Posterior
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.priors.mechanical.intervals import still_columns, still_error
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_DRAWS = 4000  # of a robot that nothing touches, for the threshold
_PER_INTERVAL = 6  # places
_ROUNDS = 8
_MISFIT = 5.0  # standard deviations of readings' misfit beyond which a search begins elsewhere
_WORSE = 1.0  # by which the cost may grow on the way: a moment stands for a place that is off
_STARTS = (0.15, 0.4, 0.65, 0.9)  # of the length
_LEVER = 0.1  # of the length, by which a place may be wrong while it is sought


@dataclass(frozen=True)
class ContactScan:
    """What a posterior at one time says of a single force somewhere along the robot.

    Attributes:
        arclength: Places (C,), m.
        log_ratio: Log evidence (C,) of a force there over none.
        force: Force (C, 3) there if it is there, N, body frame.
        cov: Its covariance (C, 3, 3).
        evidence: Log evidence of a force anywhere over none, all places being as likely.
        threshold: What `evidence` exceeds, without any contact, in a share `false_alarms` of times.
        false_alarms: That share.
    """

    arclength: Array
    log_ratio: Array
    force: Array
    cov: Array
    evidence: float
    threshold: float
    false_alarms: float

    @property
    def detected(self) -> bool:
        """Whether something touches the robot."""
        return self.evidence > self.threshold

    @property
    def best(self) -> int:
        """Index of the likeliest place."""
        return int(np.argmax(self.log_ratio))


def scan_contacts(
    posterior: Posterior, time: float, *, std_force: ArrayLike = 1.0, false_alarms: float = 0.01
) -> ContactScan:
    """Scan a posterior of a mechanical prior for one force, at the time node nearest to `time`.

    Args:
        posterior: The posterior, in whose prior there is no contact.
        time: Seconds.
        std_force: How large a force may be, N: each component (3,) in the body frame, or all.
        false_alarms: Share of times at which an untouched robot may be said to be touched.

    Raises:
        GlissandoError: The prior knows no loads.
        OutsideGridError: The time is off the grid.
    """
    prior, grid = require_mechanics(posterior.prior), posterior.grid
    grid.require(np.zeros(1), np.array([time]), "Contact")
    k = int(np.abs(grid.time - time).argmin())
    state = posterior.state.take(k)
    places, n, pull = _pulls(prior, grid, state)
    error, weight, known = _evidence_of_errors(posterior, prior, state, k)
    count, dim = len(places), 12 * (grid.arclength.size - 1)
    wide = np.zeros((count, 3, dim))
    for c in range(count):
        wide[c, :, 12 * n[c] : 12 * n[c] + 12] = pull[c].T @ weight[n[c]]
    flat = wide.reshape(-1, dim)
    vector = flat @ error.ravel()
    spread = flat @ known @ flat.T
    blocks = spread.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    variance = np.broadcast_to(np.asarray(std_force, dtype=float) ** 2, 3)
    precision = blocks + np.diag(1.0 / variance)
    cov = np.asarray(np.linalg.inv(precision), dtype=float)
    log_det = np.linalg.slogdet(np.eye(3) + variance[:, None] * blocks)[1]
    prior_of_place = np.log(_shares(places))

    def ratios(vectors: Array) -> Array:
        b = vectors.reshape(-1, count, 3)
        return 0.5 * np.einsum("dci,cij,dcj->dc", b, cov, b) - 0.5 * log_det

    value, root = np.linalg.eigh(spread)
    root = root * np.sqrt(np.maximum(value, 0.0))
    noise = np.random.default_rng(0).standard_normal((_DRAWS, len(value)))
    untouched = logsumexp(ratios(noise @ root.T) + prior_of_place, axis=1)
    here = ratios(vector[None])[0]
    return ContactScan(
        places,
        here,
        np.einsum("cij,cj->ci", cov, vector.reshape(count, 3)),
        cov,
        float(logsumexp(here + prior_of_place)),
        float(np.quantile(untouched, 1.0 - false_alarms)),
        false_alarms,
    )


def _shares(places: Array) -> Array:
    """Share (C,) of the length that each place stands for."""
    edges = np.concatenate([[0.0], 0.5 * (places[1:] + places[:-1]), places[-1:]])
    return np.diff(edges) / edges[-1]


def _pulls(prior: MechanicalPrior, grid: Grid, state: State) -> tuple[Array, Index, Array]:
    """Places (C,), their intervals (C,), and what a newton there adds to the errors (C, 12, 3)."""
    lengths = np.diff(grid.arclength)
    n = np.repeat(np.arange(lengths.size), _PER_INTERVAL)
    offset = lengths[n] * np.tile((np.arange(_PER_INTERVAL) + 0.5) / _PER_INTERVAL, lengths.size)
    start, piece = state.take(n), prior.rod.intervals(grid.arclength).take(n)
    piece = piece.accelerated(start, state.take(n + 1))
    near = piece.before(offset).flow(start, noisy=False)
    there = State(start.pose @ near.pose, near.wrench, start.velocity)
    onward = piece.beyond(offset).flow(there, noisy=False).transition
    return grid.arclength[n] + offset, n, -onward[:, :, 6:9] / piece.section.stiffness[:, None, :3]


def _evidence_of_errors(
    posterior: Posterior, prior: MechanicalPrior, state: State, k: int
) -> tuple[Array, Array, Array]:
    """Errors (N−1, 12) of intervals, Q⁻¹ (N−1, 12, 12), and the covariance that b makes of Q − P_r.

    The last (D, D) is the prior covariance of all errors less their posterior one.
    """
    count = state.strain.shape[0]
    start, end = state.take(np.s_[:-1]), state.take(np.s_[1:])
    intervals = prior.rod.intervals(posterior.grid.arclength)
    error, j0, j1 = still_error(start, end, intervals)
    noise = intervals.flow(start, noisy=True).noise
    dof = posterior.state.dof
    width = j0.shape[2]
    chosen = (np.arange(count)[:, None] * dof + still_columns(width)).ravel()
    cov = posterior.marginals.cov[k][np.ix_(chosen, chosen)]
    slope = np.zeros((count - 1, 12, count, width))
    rows = np.arange(count - 1)
    slope[rows, :, rows], slope[rows, :, rows + 1] = j0, j1
    flat = slope.reshape(12 * (count - 1), -1)
    known = -flat @ cov @ flat.T
    for i in rows:
        at = slice(12 * i, 12 * i + 12)
        known[at, at] += noise[i]
    scale = 1.0 / np.sqrt(np.einsum("mii->mi", noise))
    even = np.linalg.inv(scale[:, :, None] * noise * scale[:, None, :])
    return error, scale[:, :, None] * even * scale[:, None, :], 0.5 * (known + known.T)


@dataclass(frozen=True)
class Contact:
    """A force on the robot.

    Attributes:
        arclength: Where, m.
        std_arclength: Its standard deviation, m.
        force: Force (3,), N, in the world frame.
        cov_force: Its covariance (3, 3), the place being where it is.
        posterior: The posterior with this force, and a moment that stands for its place.
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
    std_force: ArrayLike = 1.0,
) -> Contact:
    """The place of one force and the force, with the whole rod bent anew at every step.

    A force moved by Δs makes the moment Δs t × f where it was, so Gauss–Newton moves it.

    Args:
        prior: The prior, without the contact.
        grid: Nodes; the time is the last.
        readings: Readings of each sensor.
        start: Where the search begins, m, as from a scan.
        std_force: How large a force may be, N: each component (3,) in the body frame, or all.

    Raises:
        OutsideGridError: The start is not on the robot.
    """
    length = float(grid.arclength[-1])
    if not 0.0 < start <= length:
        raise OutsideGridError(
            f"A contact at {start:g} m is off the robot of {length:g} m; give metres."
        )
    std = np.broadcast_to(np.asarray(std_force, dtype=float), 3)
    variance = np.concatenate([std**2, np.full(3, (_LEVER * length * std.max()) ** 2)])
    count = sum(len(r) * r.row_count for r in readings)
    best, reach = _touched_at(prior, grid, readings, start, variance), 0.15 * length
    if 2.0 * best.posterior.solve.cost > count + _MISFIT * np.sqrt(2.0 * count):
        for share in _STARTS:
            with suppress(UnobservableError):  # so far off that rounding decides
                other = _touched_at(prior, grid, readings, share * length, variance)
                best = min(best, other, key=lambda there: there.posterior.solve.cost)
    for _ in range(_ROUNDS):
        if abs(best.move) < 0.1 * float(np.sqrt(best.cov[3, 3])) + 1e-4 * length:
            break
        place = best.place + float(np.clip(best.move, -reach, reach))
        other = _touched_at(prior, grid, readings, place, variance, best.posterior)
        reach = 0.5 * abs(other.place - best.place)
        if reach < 1e-4 * length:
            break
        if other.posterior.solve.cost < best.posterior.solve.cost + _WORSE:
            best, reach = other, max(reach, 0.5 * abs(best.move))
    n = int(np.abs(best.posterior.grid.arclength - best.place).argmin())
    turn = best.posterior.state.pose[-1, n, :3, :3]
    place = float(np.clip(best.place + best.move, 0.0, length))
    cov = turn @ best.cov[:3, :3] @ turn.T
    return Contact(place, float(np.sqrt(best.cov[3, 3])), turn @ best.force, cov, best.posterior)


@dataclass(frozen=True)
class _Touched:
    """A force tried at a place: it, how far beyond it acts, and the covariance (4, 4) of both."""

    posterior: Posterior
    place: float
    force: Array
    cov: Array
    move: float


def _touched_at(
    prior: MechanicalPrior,
    grid: Grid,
    readings: Sequence[Readings],
    place: float,
    variance: Array,
    near_by: Posterior | None = None,
) -> _Touched:
    """The posterior with a load of this `variance` (6,) at a place, from one of a place near by."""
    length, near = float(grid.arclength[-1]), 0.25 * float(np.diff(grid.arclength).min())
    place = float(np.clip(place, near, length - near))
    others = grid.arclength[np.abs(grid.arclength - place) > near]
    others = np.union1d(np.union1d(others, prior.joints), [0.0, length])
    finer = Grid(np.union1d(others, [place]), grid.time, grid.before)
    order = np.argsort(np.append(prior.points, place))
    touched = replace(
        prior,
        points=np.append(prior.points, place)[order],
        var_points=np.concatenate([prior.var_points, variance[None]])[order],
    )
    start = None if near_by is None else near_by.states_on(finer)
    found = estimate(touched, finer, readings, initial=start)
    return _Touched(found, place, *_without_moment(found, place, variance))


def _without_moment(found: Posterior, place: float, variance: Array) -> tuple[Array, Array, float]:
    """A force (3,) without moment that explains the wrench at a node, and how far beyond it acts.

    Of the wrench's posterior what readings say is kept, its prior variance (6,) is not. Also the
    covariance (4, 4) of [force, how far].
    """
    k = found.grid.time.size - 1
    load = found.load(place, found.grid.time[k])
    n = int(np.abs(found.grid.arclength - place).argmin())
    tangent = found.state.strain[k, n, :3]
    said = np.linalg.inv(load.cov)
    information, vector = said - np.diag(1.0 / variance), said @ load.wrench
    lever = np.zeros((6, 4))
    lever[:3, :3] = np.eye(3)
    lever[3:, 3] = np.cross(tangent, load.force)
    length = float(found.grid.arclength[-1])
    known = np.diag(np.append(1.0 / variance[:3], 1.0 / length**2))
    cov = np.asarray(np.linalg.inv(lever.T @ information @ lever + known), dtype=float)
    best = cov @ lever.T @ vector
    return best[:3], cov, float(best[3])
