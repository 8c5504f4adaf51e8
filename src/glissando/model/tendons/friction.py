"""Friction in a tendon's channel: the share exp(−μ Θ) of the tension remains.

Θ is the angle by which the backbone bends the tendon; the turn of a helical channel is left out.
Friction is that of a tendon being pulled, also while it is released.
"""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array


def share_left(friction: Array, length: Array, strain: Array, unit: Array) -> Array:
    """Share (M, T, P) of each tension that remains in the middle of each piece.

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
    """Jacobian (M, P, 6, P, 6) of the tendons' wrench by strain, through friction.

    The bending of all pieces before, and half of its own, reduces the pull on a piece.

    Args:
        friction: Coefficient μ of each tendon (T,).
        length: Lengths (P,) of the pieces, m.
        place: Positions (T, P, 3) of the channels in their cross-sections, m.
        strain: Strains (M, P, 6).
        unit: Unit tangents (M, T, P, 3) of the channels.
        speed: Norms (M, T, P) of the tangents.
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
