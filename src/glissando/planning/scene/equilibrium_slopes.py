"""Gradients by a tendon robot's strains and their sensitivities, pulled back to the commands.

Source: (M5) to (M7) of docs/tendons.md; the second derivative of the equilibrium's energy.
"""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.tendons.equilibrium import Equilibrium
from glissando.model.tendons.tendon_rod import TendonRod


def back_to_displacement(
    balance: Equilibrium, own: tuple[Array, Array, Array], by_strain: Array, by_slope: Array
) -> Array:
    """Gradients (G, K, T) by displacements, from gradients by strain and by S = ∂strain/∂ξ.

    With the energy's Hessian H, A = H⁻¹ and S = −A C, dS = −A (dH S + dC). With Y = A ∂φ/∂S, a
    value φ thus changes by −Y : dH S − Y : dC, expressed by each tendon's tension τ, stiffness k,
    its derivative k′, and the length |t| of its tangent.

    Args:
        balance: K equilibria.
        own: ∂strain/∂displacement (K, P, 6, T); ∂strain/∂ξ (K, P, 6, q), tendons first; and
            the standard deviations (T,) of displacements, m, to which ξ is scaled.
        by_strain: Gradients (G, K, P, 6) of G values by strain.
        by_slope: Gradients (G, K, P, 6, q) by ∂strain/∂ξ.
    """
    (by_displacement, by_error, std), rod = own, balance.rod
    length, count = rod.length, len(rod.tendons)
    back = balance.strain_by(by_slope / length[:, None, None], balance.slope)
    reach = length[:, None] * balance.reach  # ∂stretch/∂strain
    along, along_back = (np.einsum("ktpi,...kpiq->...ktq", reach, x) for x in (by_error, back))
    arm, (_, unit, speed, inside) = rod.levers, rod.reaches(balance.strain)
    bend, bend_back = (arm @ x[..., None, :, :, :] for x in (by_error, back))
    unit_parts = [unit[..., None, :] @ x for x in (bend, bend_back)]
    flat = [x - unit[..., None] * part
            for x, part in zip((bend, bend_back), unit_parts, strict=True)]  # fmt: skip
    weight = inside * length / speed
    squared = np.sum(flat[0] * flat[1], axis=(-2, -1))
    k, slope = balance.slope, _stiffening(rod, k=balance.slope)
    curved = np.sum(weight * squared, axis=-1)
    by_stretch = k * curved + slope * np.sum(along * along_back, axis=-1)
    picked = np.arange(count)
    by_stretch += std * slope * along_back[..., picked, picked]
    # ∂|t|/∂t, through reach in `along` and through the components across t
    lever = flat[0] @ along_back[..., None, :, None] + flat[1] @ along[..., None, :, None]
    own_pull = np.moveaxis(flat[1][..., picked, :, :, picked], 0, -3)
    lever = lever[..., 0] + std[:, None, None] * own_pull
    third = flat[0] @ unit_parts[1].mT + flat[1] @ unit_parts[0].mT
    third = third[..., 0] + unit * squared[..., None]
    by_tangent = weight[..., None] * (
        k[..., None, None] * lever - (balance.tension[..., None] / speed)[..., None] * third
    )
    partial = np.einsum("tpai,...ktpa->...kpi", arm, by_tangent)
    partial += np.einsum("...kt,ktpi->...kpi", by_stretch, reach)
    by_pull = np.einsum("kpit,...kpi->...kt", by_displacement, by_strain - partial)
    return np.asarray(by_pull - by_stretch)


def _stiffening(rod: TendonRod, k: Array) -> Array:
    """Derivative (K, T) of the tendons' stiffness (K, T) by stretch, for the softened ramp."""
    share = k / rod.tendons.stiffness
    return k * (1.0 - share) / rod.tendons.softness
