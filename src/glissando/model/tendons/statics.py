"""Static shapes of a rod that is loaded by its tendons alone.

Without loads from outside, the rod's own wrench balances its tendons at every cross-section,

    K (ε − ε*) + Σ τ_j [t_j; r_j × t_j] = 0,    t_j = (ν + u × r_j + r_j′) / |…|,

and a tendon's tension follows from its stretch d_j − slack_j − (ℓ_j(straight) − ℓ_j). Strains at
different places are coupled by the tensions alone: a Newton step solves for 6 numbers a piece and T
numbers a shape. Source: (M5) to (M7); Rucker and Webster 2011 without external loads.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glissando.errors import GlissandoError, NoShapeError
from glissando.geometry.se3 import Array
from glissando.model.tendons.equilibrium import SHAPES, Equilibrium
from glissando.model.tendons.friction import share_left
from glissando.model.tendons.tendon_rod import TendonRod

_ITERATIONS = 60
_CLOSE = 1e-9  # rad and m, largest change of a piece by the last step
_LONGEST = 0.5  # rad that a step may turn a piece by


def equilibrium(
    rod: TendonRod,
    *,
    displacement: Array | None = None,
    tension: Array | None = None,
    start: Array | None = None,
) -> Equilibrium:
    """Solve for the shapes of a rod at given displacements or tensions of its tendons.

    Args:
        rod: The rod.
        displacement: Displacements (M, T), positive when pulled, less play, m.
        tension: Tensions (M, T) instead of displacements, N.
        start: Strains (M, P, 6) of the first iteration; those at rest unless given.

    Raises:
        GlissandoError: Neither or both are given, a number is missing, or a tension is negative.
        NoShapeError: No equilibrium was found.
    """
    given, solutions = _checked_inputs(rod, displacement, tension), []
    if start is None:
        start = np.broadcast_to(rod.rest, (len(given), *rod.rest.shape[-2:]))
    for first in range(0, len(given), SHAPES):
        rows = slice(first, first + SHAPES)
        part = rod.take(rows), given[rows], start[rows], first
        solutions.append(_solve_rows(*part, tensions=displacement is None))
    joined = zip(*(each.arrays() for each in solutions), strict=True)
    return Equilibrium(rod, *(np.concatenate(parts) for parts in joined))


def _solve_rows(
    rod: TendonRod, given: Array, strain: Array, first: int, *, tensions: bool
) -> Equilibrium:
    """Solve the rows from `first` on by Newton's method, beginning at strains (M, P, 6)."""
    for _ in range(_ITERATIONS):
        linearized, residual = _linearize(rod, strain, given, tensions)
        step = linearized.strain_by(residual[..., None], linearized.slope)[..., 0]  # Newton's
        turned = np.abs(step * rod.length[:, None]).max(axis=(1, 2), keepdims=True)
        strain = strain - step * np.minimum(1.0, _LONGEST / np.maximum(turned, 1e-300))
        if turned.max() < _CLOSE:
            return replace(linearized, strain=strain)
    worst = first + int(np.argmax(turned.ravel()))
    raise NoShapeError(
        f"No static shape was found for row {worst} of the tendons; is the rod buckling, or is a "
        f"displacement in millimetres?"
    )


def _checked_inputs(rod: TendonRod, displacement: Array | None, tension: Array | None) -> Array:
    if (displacement is None) == (tension is None):
        raise GlissandoError("Give displacements of the tendons or their tensions, one of the two.")
    given = np.atleast_2d(np.asarray(displacement if tension is None else tension, dtype=float))
    if given.shape[1] != len(rod.tendons) or not np.all(np.isfinite(given)):
        raise GlissandoError(
            f"{given.shape[1]} columns for {len(rod.tendons)} tendons; give a finite number each."
        )
    if tension is not None and np.any(given < 0.0):
        raise GlissandoError(f"A tension of {given.min():g} N cannot be; tendons only pull.")
    if displacement is not None and np.any(np.abs(given) > rod.nodes[-1]):
        raise GlissandoError(
            f"A tendon is displaced by {np.abs(given).max():g} m, more than the robot's length of "
            f"{rod.nodes[-1]:g} m; give metres, not millimetres."
        )
    return given


def _linearize(
    rod: TendonRod, strain: Array, given: Array, tensions: bool
) -> tuple[Equilibrium, Array]:
    """Equilibrium linearised at strains (M, P, 6), and residual wrenches (M, P, 6)."""
    reach, unit, speed, inside = rod.reaches(strain)
    stretch = given - rod.shortening(speed) - rod.tendons.slack
    force, slope = (given, np.zeros_like(given)) if tensions else rod.tendons.tension(stretch)
    share = share_left(rod.tendons.friction, rod.length, strain, unit) * inside
    pull = (reach * share[..., None]).transpose(0, 2, 3, 1)
    residual = _balance(rod, strain, pull, force)
    compliance = np.asarray(np.linalg.inv(_hessian(rod, unit, (force[..., None] * share) / speed)))
    free = reach * inside[..., None]
    return Equilibrium(rod, strain, force, compliance, pull, free, slope), residual


def _balance(rod: TendonRod, strain: Array, pull: Array, tension: Array) -> Array:
    """Residual wrench (M, P, 6) of rod and tendons on each section, zero in equilibrium."""
    return rod.stiffness * (strain - rod.rest) + (pull @ tension[:, None, :, None])[..., 0]


def misfit(
    rod: TendonRod, strain: Array, tension: Array, displacement: Array
) -> tuple[Array, Array]:
    """Residuals of the equilibrium of a rod at any strains and tensions.

    Args:
        rod: The rod.
        strain: Strains (M, P, 6).
        tension: Tensions (M, T), N.
        displacement: Displacements (M, T), less play, m.

    Returns:
        Residual wrenches (M, P, 6), and tensions (M, T) that follow from the tendons' stretch.
    """
    reach, unit, speed, inside = rod.reaches(strain)
    share = share_left(rod.tendons.friction, rod.length, strain, unit) * inside
    pull = (reach * share[..., None]).transpose(0, 2, 3, 1)
    stretch = displacement - rod.shortening(speed) - rod.tendons.slack
    return _balance(rod, strain, pull, tension), rod.tendons.tension(stretch)[0]


def _hessian(rod: TendonRod, unit: Array, force: Array) -> Array:
    """Stiffness (M, P, 6, 6) of sections with tendons; `force` (M, T, P) is tension / |tangent|."""
    out = np.zeros((unit.shape[0], unit.shape[2], 6, 6))
    out += rod.stiffness[:, :, None] * np.eye(6)
    for j, arm in enumerate(rod.levers):
        t = unit[:, j]
        across = force[:, j, :, None, None] * (np.eye(3) - t[..., :, None] * t[..., None, :])
        out += np.swapaxes(arm, -1, -2) @ across @ arm
    return out
