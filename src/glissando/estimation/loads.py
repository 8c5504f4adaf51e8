"""Internal wrenches of a rod and external loads on it, from a posterior of a mechanical prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from glissando.errors import GlissandoError, OutsideGridError
from glissando.estimation.state_estimate import Spread, StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid, Index
from glissando.model.priors.mechanical.intervals import still_columns
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.priors.prior import Prior
from glissando.model.priors.transitions import symmetrize
from glissando.model.state import State

FRAMES = ("body", "world")


@dataclass(frozen=True)
class WrenchEstimate:
    """Wrenches with covariance, with the leading shape of the query.

    Attributes:
        wrench: [force, moment] (…, 6) in N and N m, about the point of the cross-section.
        cov: Covariance (…, 6, 6) of the wrench.
        frame: Axes of the wrench: "body", those of the cross-section, or "world".
    """

    wrench: Array
    cov: Array
    frame: str

    @property
    def force(self) -> Array:
        """Force (…, 3), N."""
        return self.wrench[..., :3]

    @property
    def moment(self) -> Array:
        """Moment (…, 3), N m."""
        return self.wrench[..., 3:]

    @property
    def std(self) -> Array:
        """Standard deviations (…, 6)."""
        return np.sqrt(np.einsum("...ii->...i", self.cov))


def require_mechanics(prior: Prior, frame: str = "body") -> MechanicalPrior:
    """The prior, checked to be a mechanical one.

    Raises:
        GlissandoError: The prior has no mechanics, or the frame is neither "body" nor "world".
    """
    if frame not in FRAMES:
        raise GlissandoError(f"There is no frame {frame!r}; give one of {', '.join(FRAMES)}.")
    if not isinstance(prior, MechanicalPrior):
        raise GlissandoError(
            f"Loads need to know what the robot is made of, and its prior is {prior.kind!r}; give "
            f'the robot file a [mechanics] and a [prior] of kind = "mechanical".'
        )
    return prior


def internal_wrench(
    prior: MechanicalPrior, arclength: ArrayLike, at: StateEstimate, frame: str
) -> WrenchEstimate:
    """Internal wrenches, exerted by the part of the rod beyond on the part before. Source: (26).

    Args:
        prior: The prior.
        arclength: Arclengths, m, broadcast to the states; just beyond a point load that acts there.
        at: States (…) at these arclengths.
        frame: "body" or "world".
    """
    s = np.broadcast_to(np.asarray(arclength, dtype=float), at.strain.shape[:-1])
    wrench, stiffness = prior.rod.wrench(at.strain, s)
    slope = np.zeros((*wrench.shape, 12))
    slope[..., 6:] = stiffness[..., None] * np.eye(6)
    if frame == "world":
        wrench, slope = in_world(at.pose[..., :3, :3], wrench, slope)
    spread = slope @ at.cov[..., :12, :12] @ np.swapaxes(slope, -1, -2)
    return WrenchEstimate(wrench, symmetrize(spread), frame)


def in_world(rotation: Array, wrench: Array, slope: Array) -> tuple[Array, Array]:
    """Wrenches (…, 6) in the world's axes and their Jacobians (…, 6, c) by pose and strain.

    The first six columns of `slope` are those of the pose to which `rotation` belongs.
    """
    turned = slope.copy()
    turned[..., :3, 3:6] -= se3.hat3(wrench[..., :3])
    turned[..., 3:, 3:6] -= se3.hat3(wrench[..., 3:])
    lead = wrench.shape[:-1]
    along = np.einsum("...ij,...aj->...ai", rotation, wrench.reshape(*lead, 2, 3))
    slopes = rotation[..., None, :, :] @ turned.reshape(*lead, 2, 3, -1)
    return along.reshape(*lead, 6), slopes.reshape(*lead, 6, -1)


def load_places(prior: MechanicalPrior, grid: Grid) -> Array:
    """Arclengths (P,) where unknown loads are expected: the prior's points and the tip, m."""
    return np.union1d(prior.points, grid.arclength[-1:])


def point_loads(
    prior: Prior,
    grid: Grid,
    state: State,
    spread: Spread,
    arclength: Array,
    k: Index,
    frame: str,
) -> WrenchEstimate:
    """External wrenches at the tip or at the prior's `points`. Source: equation (28).

    Args:
        prior: A mechanical prior.
        grid: The grid.
        state: Nodes (K, N).
        spread: Computes the covariance of loads from that of the nodes.
        arclength: Places (…), m: the tip's, or some of the prior's `points`.
        k: Time nodes (…).
        frame: "body" or "world".

    Raises:
        GlissandoError: The prior has no mechanics.
        OutsideGridError: No load is expected at a place.
    """
    rod = require_mechanics(prior, frame)
    lead, arclength, k = arclength.shape, arclength.ravel(), k.ravel()
    places = load_places(rod, grid)
    n = np.abs(arclength[:, None] - grid.arclength).argmin(axis=1)
    expected = np.abs(arclength[:, None] - places).min(axis=1, initial=np.inf) < 1e-9
    if not np.all(expected):
        shown = ", ".join(f"{place:g}" for place in places)
        raise OutsideGridError(
            f"No load is expected at {arclength[~expected][0]:g} m but at {shown} m; name the "
            f"place in `points` of [prior], or ask for the internal wrench there."
        )
    load = rod.point_load(grid, state, k, n)
    wrench, slope = load.mean, load.jacobian[:, :, ::-1]  # the node of the load first
    rotation, left = state.pose[k, n, :3, :3], load.cov
    slope = slope.reshape(n.size, 6, -1)
    if frame == "world":
        wrench, slope = in_world(rotation, wrench, slope)
        both = np.zeros((n.size, 6, 6))
        both[:, :3, :3] = both[:, 3:, 3:] = rotation
        left = both @ left @ np.swapaxes(both, -1, -2)
    slope = slope.reshape(n.size, 6, 2, -1)[:, :, ::-1]
    wide = np.zeros((n.size, 6, 2, state.dof))
    wide[..., still_columns(slope.shape[-1])] = slope
    cov = spread(load.nodes, wide, left)
    return WrenchEstimate(wrench.reshape(*lead, 6), cov.reshape(*lead, 6, 6), frame)
