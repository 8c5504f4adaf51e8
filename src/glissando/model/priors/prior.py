"""The interface of priors, and densities of strain along a body of several segments."""

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
"""Density of strain (…, 6) inside intervals, and variance (…, 6) of its jump at their ends."""

_SOFT = 0.022**2  # m², least ratio of linear to bending strain density
_BEFORE = 1e-6  # of an interval: distance of places just before joints
_KERNELS = (  # of any prior
    "block_tridiagonal", "normal_equations", "process", "rolls", "se3", "sensors", "state",
)  # fmt: skip
_STRAIN_DENSITIES = "psd_strain_arclength", "psd_strain_time"
_STIFF = 10.0  # ratio of densities above which a softened prior is worth a first estimate


class Prior(Protocol):
    """A Gaussian prior over arclength × time: factors between nodes, and interpolation.

    A prior that calls compiled kernels lists their modules in `kernels`, so that an estimate
    compiles them in parallel.
    """

    kind: ClassVar[str]

    @property
    def joints(self) -> Array:
        """Arclengths (S−1,) at which segments meet, m; these must be nodes of the grid."""

    @classmethod
    def from_table(cls, prior: Table, robot: Table) -> Self:
        """Prior from the table [prior] of a robot file, and from the file with [base] and rest."""

    def to_table(self) -> dict[str, Any]:
        """Tables of a robot file for this prior, in the form that `from_table` reads."""

    @property
    def fixes_base(self) -> bool:
        """Whether the prior alone determines the pose of the base."""

    def least_step(self, arclength: Array) -> float:
        """Least distance of time nodes, s, at which information stays numerically accurate.

        Args:
            arclength: Arclength nodes (N,), m.
        """

    def with_soft_shear(self) -> Self:
        """Prior of soft shear and extension for a first estimate; itself if not stiff."""

    def rest_state(self, grid: Grid) -> State:
        """State of the robot at rest on the grid, from which an estimate starts."""

    def retract_strains(self, grid: Grid, state: State, step: Array) -> State:
        """State after a `step` (K, N, dof), with poses that still follow from the strains."""

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Factors that begin at the time nodes `times`, linearised at `state`.

        Their weights are evaluated at the rates of `noise_state`, a state on the same grid.
        """

    def static_factors(self, grid: Grid, state: State) -> Iterator[Factors]:
        """Factors of static shapes, linearised at pose and strain of nodes (S, N)."""

    def interpolate(
        self, grid: Grid, state: State, noise_state: State, points: Points
    ) -> Interpolation:
        """State at points between the nodes, conditional on the nodes."""


def load_kernels(prior: Prior, *others: str) -> None:
    """Load the compiled kernels of an estimate with this prior, and other modules of kernels.

    Args:
        prior: The prior.
        others: Modules besides those of every estimate and those that the prior lists.
    """
    load(*_KERNELS, *getattr(prior, "kernels", ()), *others)


def soften(psd: Array) -> Array:
    """Strain densities (…, 6) with a linear part of a least ratio to the bending part."""
    bending = np.mean(psd[..., 3:5], axis=-1, keepdims=True)
    return np.concatenate([np.maximum(psd[..., :3], _SOFT * bending), psd[..., 3:]], axis=-1)


def is_soft(psd: Array, soft: Array) -> bool:
    """Whether softening changes densities too little to be worth a first estimate."""
    return bool(np.all(soft <= _STIFF * psd))


def transversely_isotropic(*densities: Array) -> bool:
    """Whether densities (…, 6) are equal along the body's x and y axes."""
    return all(np.array_equal(each[..., ::3], each[..., 1::3]) for each in densities)


def without_roll_transport(prior: Prior) -> Prior:
    """Prior with densities that differ in x and y in the last digit. Source: (35).

    Its errors are then not rotated back by rolls, which is required with readings of strain along
    the body's axes: errors rotated back treat strain as rotated too, whereas readings are not.
    """
    densities = {}
    for name in _STRAIN_DENSITIES:
        if hasattr(prior, name):
            densities[name] = density = np.array(getattr(prior, name))
            density[..., 4] = np.nextafter(density[..., 4], np.inf)
    changed: Prior = replace(cast(Any, prior), **densities) if densities else prior
    return changed


def both_sides(arclength: Array, joints: Array) -> Array:
    """Arclength nodes (N,) and places just before joints, whose nodes have the strain beyond.

    Linear interpolation of strain between these places jumps where strain may jump.
    """
    at = np.flatnonzero(np.isclose(arclength, joints[:, None], rtol=0.0, atol=SAME).any(axis=0))
    at = at[at > 0]
    return np.union1d(arclength, arclength[at] - _BEFORE * (arclength[at] - arclength[at - 1]))


def by_interval(arclength: Array, psd: Array, joints: Array, jumps: Array) -> Spread:
    """Density of strain (N−1, 6) of every interval, and variance (N−1, 6) of the jump at its end.

    `psd` is (6,), or (S, 6) for S segments that meet at `joints` (S−1,), where strain may jump by
    a variance `jumps` (S−1, 6); the strain of a node at a joint is the one beyond it. Raises
    OutsideGridError when a joint is not a node of the grid.
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
    """Strain (…, 6) about which intervals are linearised: the mean without the expected jump.

    The jump takes its share of the variance of the difference between both ends; `spread` is the
    result of `by_interval` for these intervals of `length` (…), m.
    """
    psd, jump = spread
    drift = length[..., None] * psd
    return strain0 + 0.5 * drift / (drift + jump) * (strain1 - strain0)
