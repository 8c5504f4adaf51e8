"""Estimates of a load on a node: a force that may act there at any time, or one at the last time.

A force on a node increases the covariance of the error of the interval that ends there, at every
time. A posterior's linear system is solved again with this prior in place of its own. A load at the
last time is taken from the posterior, and explained by a single force elsewhere. Source: (29).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from glissando.estimation.loads import require_mechanics
from glissando.estimation.posterior import Posterior
from glissando.estimation.transported import transported
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import SAME, Index
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.solver.block_tridiagonal import BlockTridiagonal, factor
from glissando.solver.linearize import linearize
from glissando.solver.located_readings import locate

_OWN = 2.0  # time scales that a window must last for its own readings to outweigh older ones
_PLACES = 1000  # places over which a force is averaged
_System = tuple[Array, Array, Array]  # diagonal blocks, lower blocks, right-hand side


def nearest_nodes(arclength: Array, places: Array) -> Index:
    """Indices (C,) of the nodes (N,), except the base's, that are nearest to places (C,)."""
    return 1 + np.abs(arclength[1:] - places[:, None]).argmin(axis=1)


def knows_forces(posterior: Posterior) -> bool:
    """Whether a posterior's own readings determine a force at its last time.

    Readings before its first time were marginalised without a contact, which has an effect as long
    as loads last; and with inertia the modes of a rod depend on where forces act.
    """
    prior, grid = require_mechanics(posterior.prior), posterior.grid
    lasts = float(grid.time[-1] - grid.time[0])
    return prior.inertia is None and (grid.before is None or lasts >= _OWN * prior.time_scale)


def with_force(posterior: Posterior, node: int, variance: Array) -> Posterior:
    """Posterior if a force may act on a node, or half an interval beside it, at any time.

    The force decays as the prior's loads do. The linearisation is that of the given posterior.

    Args:
        posterior: Posterior of a mechanical prior, with its linearisation point.
        node: Index of the arclength node, not the base's.
        variance: Prior variance (3,) of the force, N².
    """
    own_prior = require_mechanics(posterior.prior)
    prior = _with_point(own_prior, posterior.grid.arclength, node, variance)
    diagonal, lower, rhs = _system_of(posterior)
    own, other = (_prior_alone(posterior, each) for each in (own_prior, prior))
    count = own[2].shape[1]
    diagonal[:, :count, :count] += other[0] - own[0]
    lower[:, :count, :count] += other[1] - own[1]
    rhs[:, :count] += other[2] - own[2]
    system = BlockTridiagonal(diagonal, lower)
    cholesky = factor(system)
    start = posterior.linearization_point
    step = cholesky.solve(rhs)[:, :count].reshape(*start.pose.shape[:2], start.dof)
    state = start.retract(step)
    marginals = transported(start, state, cholesky.marginals())  # (35)
    return replace(posterior, prior=prior, state=state, system=system, marginals=marginals)


def force_at(posterior: Posterior, node: int, variance: Array, rows: Index) -> tuple[Array, Array]:
    """Forces (K, 3) on a node at time nodes `rows` (K,), world frame, and covariances (K, 3, 3).

    Args:
        posterior: Posterior as for `with_force`.
        node: Index of the arclength node, not the base's.
        variance: Prior variance (3,) of the force, N².
        rows: Indices of the time nodes.
    """
    grid = posterior.grid
    touched = with_force(posterior, node, variance)
    load = touched.load(grid.arclength[node], grid.time[rows], frame="world")
    return load.force, load.cov[..., :3, :3]


def _with_point(
    prior: MechanicalPrior, arclength: Array, node: int, variance: Array
) -> MechanicalPrior:
    """The prior with a load of this variance on a node, added to loads expected there."""
    lever = 0.5 * float(np.diff(arclength)[node - 1 : node + 1].max())
    more = np.concatenate([variance, np.full(3, lever**2 * variance.max())])
    place = float(arclength[node])
    if node == arclength.size - 1:
        return replace(prior, var_tip=prior.var_tip + more)
    points, var_points = prior.points, prior.var_points
    known = np.abs(points - place) < SAME
    if known.any():
        return replace(prior, var_points=var_points + known[:, None] * more)
    at = int(np.searchsorted(points, place))
    return replace(
        prior,
        points=np.insert(points, at, place),
        var_points=np.insert(var_points, at, more, axis=0),
    )


def _system_of(posterior: Posterior) -> _System:
    """Copy of a posterior's system and right-hand side about its linearisation point."""
    system, start = posterior.system, posterior.linearization_point
    count = posterior.grid.time.size
    step = np.zeros(system.diagonal.shape[:2])
    step[:, : start.numbers] = posterior.state.difference(start).reshape(count, -1)
    rhs = np.einsum("kij,kj->ki", system.diagonal, step)
    rhs[1:] += np.einsum("kij,kj->ki", system.lower, step[:-1])
    rhs[:-1] += np.einsum("kji,kj->ki", system.lower, step[1:])
    return system.diagonal.copy(), system.lower.copy(), rhs


def _prior_alone(posterior: Posterior, prior: MechanicalPrior) -> _System:
    """System of a prior alone at a posterior's linearisation point."""
    states = posterior.linearized or (posterior.state, posterior.state)
    alone = linearize(prior, locate(posterior.grid, []), *states)
    return alone.system.diagonal, alone.system.lower, alone.rhs


@dataclass(frozen=True)
class Wrench:
    """Wrench on a node, world frame: posterior mean, and information of the readings alone.

    A force without moment that acts Δs beyond the node has the moment Δs t × f there.

    Attributes:
        mean: Posterior mean (6,) of the wrench, N and N m.
        vector: Information vector (6,) of the readings, N⁻¹ and (N m)⁻¹.
        information: Information matrix (6, 6) of the readings.
        tangent: Tangent t (3,) of the backbone.
        of_force: Prior information (3, 3) of a force, N⁻².
    """

    mean: Array
    vector: Array
    information: Array
    tangent: Array
    of_force: Array

    def beyond(self, length: float) -> tuple[float, float]:
        """Distance beyond the node at which a force acts, m, linear about the mean, and its std.

        Args:
            length: Length of the robot, m, the prior standard deviation of the place.
        """
        lever = np.zeros((6, 4))
        lever[:3, :3] = np.eye(3)
        lever[3:, 3] = np.cross(self.tangent, self.mean[:3])
        known = np.zeros((4, 4))
        known[:3, :3], known[3, 3] = self.of_force, length**-2.0
        cov = np.linalg.inv(lever.T @ self.information @ lever + known)
        return float(cov[3] @ lever.T @ self.vector), float(np.sqrt(cov[3, 3]))

    def over_places(self, place: float, length: float) -> tuple[float, float, Array, Array]:
        """Mean of place and force, with standard deviation and covariance (3, 3), over all places.

        Near the base readings determine the product of force and place, so the force varies as one
        over the place: it is Gaussian only given the place, and is averaged over places.

        Args:
            place: Arclength of the node, m.
            length: Length of the robot, m.
        """
        places, force, cov, explained = self._forces(place, length)
        log = 0.5 * explained + 0.5 * np.linalg.slogdet(cov)[1]
        share = np.exp(log - logsumexp(log))
        where, mean = share @ places, share @ force
        spread = np.einsum("p,pi,pj->ij", share, force - mean, force - mean)
        std = np.hypot(np.sqrt(share @ (places - where) ** 2), length / _PLACES / np.sqrt(12.0))
        return float(where), float(std), mean, np.einsum("p,pij->ij", share, cov) + spread

    def beside_one_force(self, place: float, length: float) -> float:
        """Squared misfit of one force at its best place: χ² of two degrees of freedom, or less.

        A wrench has six components; a force has three, and its place is a fourth. Several forces,
        or a moment, leave a larger misfit.

        Args:
            place: Arclength of the node, m.
            length: Length of the robot, m.
        """
        return float(self.vector @ self.mean - self._forces(place, length)[3].max())

    def _forces(self, place: float, length: float) -> tuple[Array, Array, Array, Array]:
        """Estimates of one force at each of P places along the robot.

        Returns:
            The places (P,), forces (P, 3) with covariances (P, 3, 3), and the χ² (P,) that each
            explains.
        """
        places = (np.arange(_PLACES) + 0.5) * length / _PLACES
        lever = np.zeros((_PLACES, 6, 3))
        lever[:, :3] = np.eye(3)
        lever[:, 3:] = (places - place)[:, None, None] * se3.hat3(self.tangent)
        back = np.swapaxes(lever, -1, -2)
        vector = back @ self.vector
        cov = np.asarray(np.linalg.inv(back @ self.information @ lever + self.of_force))
        force = np.einsum("pij,pj->pi", cov, vector)
        return places, force, cov, np.einsum("pi,pi->p", force, vector)


def wrench_at(posterior: Posterior, place: float, variance: Array) -> Wrench:
    """Estimate of the load on a node at the last time.

    Its axes are the world's, as a torsional moment that has ceased would turn those of the body.

    Args:
        posterior: The posterior, whose prior expects a load there.
        place: Arclength of the node, m.
        variance: Prior variance (6,) of the load, body frame.
    """
    k = posterior.grid.time.size - 1
    load = posterior.load(place, posterior.grid.time[k], frame="world")
    n = int(np.abs(posterior.grid.arclength - place).argmin())
    turn = posterior.state.pose[k, n, :3, :3]
    rotation = np.kron(np.eye(2), turn)
    info, prior_info = np.asarray(np.linalg.inv(load.cov)), rotation / variance @ rotation.T
    tangent = turn @ posterior.state.strain[k, n, :3]
    vector = np.asarray(info @ load.wrench, dtype=float)
    return Wrench(load.wrench, vector, info - prior_info, tangent, prior_info[:3, :3])
