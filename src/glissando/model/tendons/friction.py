"""What friction along its channel leaves of a tendon's tension: exp(−μ Θ).

Θ is the angle by which the backbone bends the tendon; what a helical channel turns is left out.
Friction acts as when the tendon is pulled, also where it is let go.
"""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array


def share_left(friction: Array, length: Array, strain: Array, unit: Array) -> Array:
    """What is left (M, T, P) of each tension in the middle of each piece.

    Args:
        friction: Coefficient μ of each tendon (T,).
        length: Lengths (P,) of the pieces, m.
        strain: Strains (M, P, 6).
        unit: Unit tangents (M, T, P, 3) of the channels.
    """
    if not friction.any():
        return np.ones(unit.shape[:-1])
    bend = np.linalg.norm(np.cross(strain[:, None, :, 3:], unit), axis=-1) * length
    passed = np.cumsum(bend, axis=-1) - 0.5 * bend
    return np.asarray(np.exp(-friction[:, None] * passed))


def wrench_by_strain(
    friction: Array, length: Array, place: Array, strain: Array, unit: Array, speed: Array,
    force: Array,
) -> Array:  # fmt: skip
    """Slope (M, P, 6, P, 6) of the tendons' wrench by strain, through what friction leaves.

    The bends of pieces before, and half its own, ease the pull on each.

    Args:
        friction: Coefficient μ of each tendon (T,).
        length: Lengths (P,) of the pieces, m.
        place: Places of the channels in their cross-sections, m.
        strain: Strains (M, P, 6).
        unit: Unit tangents (M, T, P, 3) of the channels.
        speed: Lengths (M, T, P) of the tangents.
        force: Wrenches (M, T, P, 6) of the tendons.
    """
    turn = strain[:, None, :, 3:]
    across = np.cross(turn, unit)
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    across = across / np.where(size > 0.0, size, 1.0)
    by_unit = np.cross(across, turn)
    by_tangent = by_unit - unit * np.sum(unit * by_unit, axis=-1, keepdims=True)
    by_tangent /= speed[..., None]
    by_turn = np.cross(unit, across) + np.cross(np.broadcast_to(place, unit.shape), by_tangent)
    by_strain = length[:, None] * np.concatenate([by_tangent, by_turn], axis=-1)
    count = length.size
    before = np.tril(np.ones((count, count)), -1) + 0.5 * np.eye(count)
    rubbing = -friction[:, None, None] * force
    return np.einsum("mtpi,pq,mtqj->mpiqj", rubbing, before, by_strain)
