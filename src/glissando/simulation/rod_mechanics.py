"""Mass, damping and stiffness matrices, energies and powers of a moving rod."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from glissando.geometry.se3 import Array, hat3
from glissando.simulation.rod_equations import AppliedLoads, Balance, RodEquations

_LEVER = 0.1  # of the length: arm that converts rotations to displacements


class Matrices(NamedTuple):
    """Jacobians (6G, 6G) of the weighted residual by acceleration, velocity and strain.

    `moves` (6G, 6G) maps a change of strain to displacements of the points, and to their rotations
    times a tenth of the length, m.
    """

    mass: Array
    damping: Array
    stiffness: Array
    moves: Array


def matrices(equations: RodEquations, at: Balance, instant: AppliedLoads) -> Matrices:
    """Matrices for Newton's iteration; symmetric for tendons without friction.

    Gyroscopic terms and the derivative of inertia by strain are neglected; they are small compared
    with mass over squared step length.
    """
    moves, turns = _moves(equations, at)
    points, size = turns.shape[0], equations.size
    weights, section = equations.mesh.weights, equations.section
    spin = np.einsum("gij,j,gkj->gik", at.turn[:points], section[2, 1:4], at.turn[:points])
    mass = _square(moves[:points], (weights * section[2, 0])[:, None, None] * np.eye(3))
    mass += _square(turns, weights[:, None, None] * spin)
    stiff, damp = _contact_blocks(equations, at, instant)
    air = np.zeros((len(at.place), 1, 1))
    air[:points, 0, 0] = weights * section[2, 4]
    damping, stiffness = np.zeros((size, size)), equations.stiffness(at, instant.cables)
    if np.any(stiff):
        stiffness += _square(moves, stiff)
    if np.any(damp) or np.any(air):
        damping += _square(moves, damp + air * np.eye(3))
    damping[np.diag_indices(size)] += (weights[:, None] * section[1]).ravel()
    lever = _LEVER * equations.rod.length
    reach = np.concatenate([moves[:points], lever * turns]).reshape(-1, size)
    return Matrices(mass, damping, stiffness, reach)


def natural_frequencies(equations: RodEquations, at: Balance, instant: AppliedLoads) -> Array:
    """Natural frequencies (6G,) of undamped vibrations about an equilibrium, Hz, ascending."""
    linear = matrices(equations, at, instant)
    squares = eigh(linear.stiffness, linear.mass, eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)


def _moves(equations: RodEquations, at: Balance) -> tuple[Array, Array]:
    """Jacobians of positions of places (S, 3, 6G) and rotations of points (G, 3, 6G) by strain.

    Both are in world axes.
    """
    before, points = equations.before, len(equations.rest)
    turn = at.turn[:points]
    lever = [before @ (along[:, None] * before[:points]) for along in at.along.T]
    moves, turns = (
        np.zeros((len(before), 3, points, 6)),
        np.zeros((points, 3, points, 6)),
    )
    shift = np.einsum("sh,hij->sihj", before, turn, optimize=True)
    moves[..., :3] = shift
    skew = hat3(np.stack(lever, axis=-1))
    moves[..., 3:] = np.swapaxes(-skew @ turn, 1, 2)
    turns[..., 3:] = shift[:points]
    return moves.reshape(len(before), 3, -1), turns.reshape(points, 3, -1)


def _square(operator: Array, blocks: Array) -> Array:
    """Sum over places of operatorᵀ block operator; operator (S, 3, n), blocks (S, 3, 3)."""
    flat = operator.reshape(-1, operator.shape[-1])
    return flat.T @ (blocks @ operator).reshape(flat.shape)


def _contact_blocks(
    equations: RodEquations, at: Balance, instant: AppliedLoads
) -> tuple[Array, Array]:
    """Stiffness and damping (S, 3, 3) of contacts and springs at the places."""
    points, weights = len(equations.rest), equations.mesh.weights
    stiff, damp = np.zeros((2, len(at.place), 3, 3))
    for plane in instant.planes:
        normal, speed = plane[3:6], -at.rates[0, :points] @ plane[3:6]
        depth = np.maximum((plane[:3] - at.place[:points]) @ normal, 0.0)
        push = np.maximum(1.0 + plane[7] * speed, 0.0)
        square = np.multiply.outer(normal, normal)
        slide = at.rates[0, :points] + speed[:, None] * normal
        rub = plane[8] * plane[6] * depth * push / np.sqrt(np.sum(slide**2, axis=1) + 1e-6)
        stiff[:points] += (weights * (depth > 0) * plane[6] * push)[:, None, None] * square
        damp[:points] += (weights * plane[6] * plane[7] * depth)[:, None, None] * square
        damp[:points] += (weights * rub)[:, None, None] * (np.eye(3) - square)
    for row in instant.sites:
        stiff[points + int(row[0])] += row[10] * np.eye(3)
        damp[points + int(row[0])] += row[11] * np.eye(3)
    return stiff, damp


def energies(equations: RodEquations, state: Array, at: Balance, gravity: Array) -> Array:
    """Kinetic, strain and gravitational potential energy (3,), J."""
    points, weights, section = len(equations.rest), equations.mesh.weights, equations.section
    spin = np.einsum("gji,gj->gi", at.turn[:points], at.rates[1, :points])
    motion = section[2, 0] * np.sum(at.rates[0, :points] ** 2, axis=1) + spin**2 @ section[2, 1:4]
    bent = (state[0] - equations.rest) ** 2 @ section[0]
    height = -section[2, 0] * at.place[:points] @ gravity
    return np.array([0.5 * weights @ motion, 0.5 * weights @ bent, weights @ height])


def powers(equations: RodEquations, state: Array, at: Balance, instant: AppliedLoads) -> Array:
    """Powers (3,) of tendons, loads and base; of contacts and springs; of damping (≤ 0), W."""
    points, weights, section = len(equations.rest), equations.mesh.weights, equations.section
    velocity = at.rates[0, :points]
    lost = -(state[1] ** 2) @ section[1] - section[2, 4] * np.sum(velocity**2, axis=1)
    touching = np.sum(at.touch[0] * velocity, axis=1)
    wrench = np.concatenate([at.unit, np.cross(equations.paths[:, 0], at.unit)], axis=-1)
    pulled = -np.einsum("tg,tgi,gi->g", at.pull, wrench, state[1])
    supplied = weights @ pulled - np.sum(at.carried[:, -1] * instant.base_rates[:2])
    at_ends = np.concatenate([at.rates[0, points:], at.rates[1, points:]], axis=1)
    held = np.sum(at.ends * at_ends)
    for row in instant.sites:
        dead = float(row[1:7] @ at_ends[int(row[0])])
        supplied, held = supplied + dead, held - dead
    return np.array([supplied, weights @ touching + held, weights @ lost])
