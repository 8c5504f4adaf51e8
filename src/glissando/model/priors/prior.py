"""What the method asks of a prior, and how strain may vary along a body made of segments."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, ClassVar, Protocol, Self, cast

import numpy as np

from glissando._kernels.jit import load
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors
from glissando.model.grid import SAME, Grid, node_at
from glissando.model.interpolation import Interpolation, Points
from glissando.model.state import State
from glissando.model.table import Table

Spread = tuple[Array, Array]
"""Of intervals: the density of strain (…, 6) inside them, and the variance (…, 6) of its jump."""

_SOFT = 0.022**2  # m², of strain density over curvature density
_BEFORE = 1e-6  # of an interval, at which a place lies just before a joint
_KERNELS = (  # of any prior
    "block_tridiagonal", "normal_equations", "process", "rolls", "se3", "sensors", "state",
)  # fmt: skip
_STRAIN_DENSITIES = "psd_strain_arclength", "psd_strain_time"
_STIFF = 10.0  # times softer than a prior must be to be worth a start of its own


class Prior(Protocol):
    """A Gaussian prior over arclength × time: factors between nodes, and what lies between them.

    One whose functions call compiled kernels names their modules in `kernels`, so that an estimate
    compiles them side by side.
    """

    kind: ClassVar[str]

    @property
    def joints(self) -> Array:
        """Where segments meet (S−1,), m; these must be nodes of the grid."""

    @classmethod
    def from_table(cls, prior: Table, robot: Table) -> Self:
        """The prior of a robot file, from its [prior] table and the file with [base] and rest."""

    def to_table(self) -> dict[str, Any]:
        """What a robot file says of this prior, as `from_table` reads it."""

    @property
    def fixes_base(self) -> bool:
        """Whether the prior alone says where the robot stands."""

    def least_step(self, arclength: Array) -> float:
        """The least time between time nodes, s, at which information keeps its digits.

        Args:
            arclength: Arclength nodes (N,), m.
        """

    def with_soft_shear(self) -> Self:
        """The prior with soft shear and extension, a start for this one; itself if not stiff."""

    def rest_state(self, grid: Grid) -> State:
        """The robot at rest on the grid, from which an estimate starts."""

    def retract_strains(self, grid: Grid, state: State, step: Array) -> State:
        """The state moved by `step` (K, N, dof) so that poses still follow from the strains."""

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Factors that begin at the time nodes `times`, linearised at `state`.

        Their weights come from the rates of `noise_state`, a state on the same grid.
        """

    def static_factors(self, grid: Grid, state: State) -> Iterator[Factors]:
        """Factors of shapes that hold still, linearised at nodes (S, N) of pose and strain."""

    def interpolate(
        self, grid: Grid, state: State, noise_state: State, points: Points
    ) -> Interpolation:
        """State at points between the nodes, conditional on the nodes."""


def load_kernels(prior: Prior, *others: str) -> None:
    """Make callable what an estimate with this prior calls, and other modules of kernels.

    Args:
        prior: The prior.
        others: Modules besides those of every estimate and those that the prior names.
    """
    load(*_KERNELS, *getattr(prior, "kernels", ()), *others)


def soften(psd: Array) -> Array:
    """Strain densities (…, 6) whose linear part is large enough beside their bending part."""
    bending = np.mean(psd[..., 3:5], axis=-1, keepdims=True)
    return np.concatenate([np.maximum(psd[..., :3], _SOFT * bending), psd[..., 3:]], axis=-1)


def is_soft(psd: Array, soft: Array) -> bool:
    """Whether softening changed so little that a start of its own would not pay."""
    return bool(np.all(soft <= _STIFF * psd))


def transversely_isotropic(*densities: Array) -> bool:
    """Whether densities (…, 6) are the same across the body's z in every direction."""
    return all(np.array_equal(each[..., ::3], each[..., 1::3]) for each in densities)


def without_roll_transport(prior: Prior) -> Prior:
    """The prior with densities that differ in x and y by a last digit. Source: (35).

    Its errors keep their axes, as they have to beside readings of strain along the body's axes: an
    error that is turned back by a roll counts strain as turned with it, and what is read does not.
    """
    apart = {}
    for name in _STRAIN_DENSITIES:
        if hasattr(prior, name):
            apart[name] = density = np.array(getattr(prior, name))
            density[..., 4] = np.nextafter(density[..., 4], np.inf)
    told: Prior = replace(cast(Any, prior), **apart) if apart else prior
    return told


def both_sides(arclength: Array, joints: Array) -> Array:
    """Nodes (N,) of a grid and places just before joints: a node there has the strain beyond it.

    Lines through the strains at these places jump where strain may jump.
    """
    at = np.flatnonzero(np.isclose(arclength, joints[:, None], rtol=0.0, atol=SAME).any(axis=0))
    at = at[at > 0]
    return np.union1d(arclength, arclength[at] - _BEFORE * (arclength[at] - arclength[at - 1]))


def by_interval(arclength: Array, psd: Array, joints: Array, jumps: Array) -> Spread:
    """Density of strain (N−1, 6) of every interval between nodes, and of its jump at the end.

    `psd` is (6,), or (S, 6) for S segments that meet at `joints` (S−1,), where strain may jump by
    a variance `jumps` (S−1, 6); the strain of a node at a joint is the one beyond it. Raises
    OutsideGridError when a joint is no node of the grid.
    """
    jump = np.zeros((arclength.size - 1, 6))
    for joint, variance in zip(joints, jumps if np.any(jumps) else 0.0 * joints, strict=True):
        at = node_at(arclength, joint, "The robot has a joint")
        if at:
            jump[at - 1] = variance
    if psd.ndim == 1 and not np.any(jumps):
        return np.full(jump.shape, psd), jump
    psd = np.broadcast_to(psd, (joints.size + 1, 6))
    middle = 0.5 * (arclength[1:] + arclength[:-1])
    return psd[np.searchsorted(joints, middle)], jump


def interval_strain(strain0: Array, strain1: Array, length: Array, spread: Spread) -> Array:
    """Strain (…, 6) about which intervals are linearised: the mean, less the jump at their end.

    Of the difference between both ends, the jump has its share of the variance; `spread` is what
    `by_interval` gives for these intervals of `length` (…).
    """
    psd, jump = spread
    drift = length[..., None] * psd
    return strain0 + 0.5 * drift / (drift + jump) * (strain1 - strain0)
