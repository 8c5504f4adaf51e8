"""The shape that tendons pull an unloaded rod into.

Without loads from outside, the rod's own wrench balances its tendons at every cross-section,

    K (ε − ε*) + Σ τ_j [t_j; r_j × t_j] = 0,    t_j = (ν + u × r_j + r_j′) / |…|,

and a tendon's tension follows from its stretch d_j − slack_j − (ℓ_j(straight) − ℓ_j). Strains at
different places are tied by the tensions alone: a Newton step solves 6 numbers a piece and T
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
_CLOSE = 1e-9  # of a step of all pieces together, rad and relative stretch
_LONGEST = 0.5  # rad that a step may turn a piece by


def equilibrium(
    rod: TendonRod,
    *,
    displacement: Array | None = None,
    tension: Array | None = None,
    start: Array | None = None,
) -> Equilibrium:
    """The shapes that displacements or tensions of the tendons pull the rod into.

    Args:
        rod: The rod.
        displacement: Displacements (M, T), positive when pulled, less play, m.
        tension: Tensions (M, T) in the place of displacements, N.
        start: Strains (M, P, 6) to begin at.

    Raises:
        GlissandoError: Neither or both are given, a number is missing, or a tension is negative.
        NoShapeError: No equilibrium was found.
    """
    given, found = _checked_inputs(rod, displacement, tension), []
    if start is None:
        start = np.broadcast_to(rod.rest, (len(given), *rod.rest.shape[-2:]))
    for first in range(0, len(given), SHAPES):
        rows = slice(first, first + SHAPES)
        part = rod.take(rows), given[rows], start[rows], first
        found.append(_solved(*part, tensions=displacement is None))
    joined = zip(*(each.arrays() for each in found), strict=True)
    return Equilibrium(rod, *(np.concatenate(parts) for parts in joined))


def _solved(
    rod: TendonRod, given: Array, strain: Array, first: int, *, tensions: bool
) -> Equilibrium:
    """The shapes of rows from the `first` on, by Newton's method from strains (M, P, 6)."""
    for _ in range(_ITERATIONS):
        here, residual = _linearize(rod, strain, given, tensions)
        step = here.strain_by(residual[..., None], here.slope)[..., 0]  # Newton's, to be taken off
        turned = np.abs(step * rod.length[:, None]).max(axis=(1, 2), keepdims=True)
        strain = strain - step * np.minimum(1.0, _LONGEST / np.maximum(turned, 1e-300))
        if turned.max() < _CLOSE:
            return replace(here, strain=strain)
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
    """The balance linearised at strains (M, P, 6), and the wrenches (M, P, 6) left over."""
    reach, unit, speed, inside = rod.reaches(strain)
    stretch = given - rod.shortening(speed) - rod.tendons.slack
    force, slope = (given, np.zeros_like(given)) if tensions else rod.tendons.tension(stretch)
    left = share_left(rod.tendons.friction, rod.length, strain, unit) * inside
    pull = (reach * left[..., None]).transpose(0, 2, 3, 1)
    residual = _balance(rod, strain, pull, force)
    compliance = np.asarray(np.linalg.inv(_hessian(rod, unit, (force[..., None] * left) / speed)))
    free = reach * inside[..., None]
    return Equilibrium(rod, strain, force, compliance, pull, free, slope), residual


def _balance(rod: TendonRod, strain: Array, pull: Array, tension: Array) -> Array:
    """Wrench (M, P, 6) of the rod and of its tendons on each section, zero in equilibrium."""
    return rod.stiffness * (strain - rod.rest) + (pull @ tension[:, None, :, None])[..., 0]


def misfit(
    rod: TendonRod, strain: Array, tension: Array, displacement: Array
) -> tuple[Array, Array]:
    """How far a rod is from balance at strains and tensions that need not be its own.

    Args:
        rod: The rod.
        strain: Strains (M, P, 6).
        tension: Tensions (M, T), N.
        displacement: Displacements (M, T), less play, m.

    Returns:
        Wrenches left (M, P, 6), and the tensions (M, T) of the tendons' stretch.
    """
    reach, unit, speed, inside = rod.reaches(strain)
    left = share_left(rod.tendons.friction, rod.length, strain, unit) * inside
    pull = (reach * left[..., None]).transpose(0, 2, 3, 1)
    stretch = displacement - rod.shortening(speed) - rod.tendons.slack
    return _balance(rod, strain, pull, tension), rod.tendons.tension(stretch)[0]


def _hessian(rod: TendonRod, unit: Array, force: Array) -> Array:
    """Stiffness (M, P, 6, 6) of the sections under the tendons' `force` (M, T, P) over length."""
    out = np.zeros((unit.shape[0], unit.shape[2], 6, 6))
    out += rod.stiffness[:, :, None] * np.eye(6)
    for j, arm in enumerate(rod.levers):
        t = unit[:, j]
        across = force[:, j, :, None, None] * (np.eye(3) - t[..., :, None] * t[..., None, :])
        out += np.swapaxes(arm, -1, -2) @ across @ arm
    return out
