"""What readings say of a load on a node, and of a single force that would explain it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from glissando.estimation.posterior import Posterior
from glissando.geometry import se3
from glissando.geometry.se3 import Array

_PLACES = 1000  # over which a force is summed


@dataclass(frozen=True)
class Wrench:
    """What readings say of the wrench (6,) on a node, world frame, its prior left out.

    A force without moment that acts Δs beyond the node makes the moment Δs t × f there.

    Attributes:
        mean: The wrench with its prior (6,), N and N m.
        vector: Information vector (6,) of the readings, N⁻¹ and (N m)⁻¹.
        information: Their information (6, 6).
        tangent: Tangent t (3,) of the backbone.
        of_force: Prior information (3, 3) of a force, N⁻².
    """

    mean: Array
    vector: Array
    information: Array
    tangent: Array
    of_force: Array

    def beyond(self, length: float) -> tuple[float, float]:
        """How far beyond the node a force acts, m, about the mean, and its standard deviation.

        Args:
            length: Length of the robot, m, by which a place is unknown before.
        """
        lever = np.zeros((6, 4))
        lever[:3, :3] = np.eye(3)
        lever[3:, 3] = np.cross(self.tangent, self.mean[:3])
        known = np.zeros((4, 4))
        known[:3, :3], known[3, 3] = self.of_force, length**-2.0
        cov = np.linalg.inv(lever.T @ self.information @ lever + known)
        return float(cov[3] @ lever.T @ self.vector), float(np.sqrt(cov[3, 3]))

    def over_places(self, place: float, length: float) -> tuple[float, float, Array, Array]:
        """Place and force, with standard deviation and covariance (3, 3), over all places.

        Near the base readings show force times place, and the force goes with one over the place:
        it is Gaussian at each place alone, so places are summed over.

        Args:
            place: Arclength of the node, m.
            length: Length of the robot, m.
        """
        places = (np.arange(_PLACES) + 0.5) * length / _PLACES
        lever = np.zeros((_PLACES, 6, 3))
        lever[:, :3] = np.eye(3)
        lever[:, 3:] = (places - place)[:, None, None] * se3.hat3(self.tangent)
        back = np.swapaxes(lever, -1, -2)
        cov = np.asarray(np.linalg.inv(back @ self.information @ lever + self.of_force))
        force = np.einsum("pij,pj->pi", cov, back @ self.vector)
        log = 0.5 * np.einsum("pi,pi->p", force, back @ self.vector)
        log += 0.5 * np.linalg.slogdet(cov)[1]
        share = np.exp(log - logsumexp(log))
        where, mean = share @ places, share @ force
        spread = np.einsum("p,pi,pj->ij", share, force - mean, force - mean)
        std = np.hypot(np.sqrt(share @ (places - where) ** 2), length / _PLACES / np.sqrt(12.0))
        return float(where), float(std), mean, np.einsum("p,pij->ij", share, cov) + spread


def wrench_at(posterior: Posterior, place: float, variance: Array) -> Wrench:
    """What readings say of the load on a node at the last time.

    Along the world's axes, as a torsional moment that is no more would turn those of the body.

    Args:
        posterior: The posterior, whose prior expects a load there.
        place: Arclength of the node, m.
        variance: Prior variance (6,) of the load, body frame.
    """
    k = posterior.grid.time.size - 1
    load = posterior.load(place, posterior.grid.time[k], frame="world")
    n = int(np.abs(posterior.grid.arclength - place).argmin())
    turn = posterior.state.pose[k, n, :3, :3]
    turns = np.kron(np.eye(2), turn)
    whole, before = np.asarray(np.linalg.inv(load.cov)), turns / variance @ turns.T
    tangent = turn @ posterior.state.strain[k, n, :3]
    vector = np.asarray(whole @ load.wrench, dtype=float)
    return Wrench(load.wrench, vector, whole - before, tangent, before[:3, :3])
