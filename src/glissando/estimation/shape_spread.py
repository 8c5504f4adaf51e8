"""Spread of shapes: second moments where the covariance is too large for a tangent space.

A linearised estimate moves poses along straight lines. A body with uncertain strains bends instead:
its points stay within its length of the base, and rotations wrap around. Shapes are drawn from the
estimate, built from the base outwards, and their second moments about the mean computed. Draws that
would wind the body up are scaled down, for each node until it may merely point anywhere. Velocities
are built from the base outwards as well: how fast a point moves, and in which of its own axes,
depends on the shape before it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.priors.steps import static_steps
from glissando.model.state import DOF, POSE, STRAIN, VELOCITY, State

_WOUND = float(np.pi)  # rad: largest std of a node's rotation; more would wind the body up
_STRETCH = 1.1  # times its length: farthest reach of a body
_PAIRS = 128  # pairs of antithetic draws
_UNMOVED = np.eye(4)


class ShapeSpread(StateEstimate):
    """Estimate whose covariance is the second moment of shapes, arcs of positions included."""

    @staticmethod
    def of(estimate: StateEstimate) -> ShapeSpread:
        """The estimate with the arcs' part of the position covariance included (30)."""
        cov = estimate.cov.copy()
        cov[..., :3, :3] = estimate.position_covariance()
        return ShapeSpread(estimate.pose, estimate.strain, estimate.velocity, cov)

    def position_covariance(self, mount: Array = _UNMOVED) -> Array:
        """Covariance (…, 3, 3) of a mounted frame's position, in its axes. Source: (30).

        Args:
            mount: Pose (4, 4) of the frame on the body.
        """
        lever = se3.adjoint(se3.inverse(mount))[:3]
        return lever @ self.cov[..., :6, :6] @ lever.T


def spread_between(
    arclength: Array, nodes: StateEstimate, place: Array, at: StateEstimate
) -> ShapeSpread:
    """Estimate at places (…) with the spread of shapes, linear between the nodes.

    Each node's covariance is in its own body frame, and so nearly in that of a place beside it.

    Args:
        arclength: Nodes (N,), m.
        nodes: Estimate at the nodes (N,), with the spread of shapes.
        place: Arclengths of the places, m.
        at: Linearised estimate at the places.
    """
    cov = between_nodes(arclength, nodes.cov, place)
    return ShapeSpread(at.pose, at.strain, at.velocity, cov)


def merged(late: NDArray[np.bool_], early: StateEstimate, other: StateEstimate) -> StateEstimate:
    """Merge estimates of two groups of points into a spread of shapes if either is one.

    Args:
        late: Mask (…) of the points of the second group.
        early: Estimate at the points of the first group.
        other: Estimate at the points of the second group.
    """
    spread = ShapeSpread in (type(early), type(other))
    if spread:
        early, other = (
            e if isinstance(e, ShapeSpread) else ShapeSpread.of(e) for e in (early, other)
        )
    out = []
    for name in ("pose", "strain", "velocity", "cov"):
        one, two = getattr(early, name), getattr(other, name)
        values = np.empty((*late.shape, *one.shape[1:]))
        values[~late], values[late] = one, two
        out.append(values)
    return ShapeSpread(*out) if spread else StateEstimate(*out)


def between_nodes(arclength: Array, cov: Array, place: Array) -> Array:
    """Covariances at places (…), linear between those (N, d, d) of the nodes (N,)."""
    upper = np.clip(np.searchsorted(arclength, place), 1, arclength.size - 1)
    share = (place - arclength[upper - 1]) / (arclength[upper] - arclength[upper - 1])
    share = np.asarray(share)[..., None, None]
    out: Array = (1.0 - share) * cov[upper - 1] + share * cov[upper]
    return out


def tip_spread(state: State, cov: Array) -> tuple[float, float]:
    """RMS displacement (m) and swing (rad) of the tip from the joint covariance (D, D) of a time.

    The swing is the rotation of the tangent. A roll about the tangent, which a coil does not
    measure, moves no point of the body.

    Args:
        state: Mean (N,).
        cov: Joint covariance of the nodes' unknowns, and of any that follow.
    """
    first = (state.pose.shape[0] - 1) * state.dof
    moves, turns = (cov[at : at + 3, at : at + 3] for at in (first, first + 3))
    tangent = state.strain[-1, :3] / np.linalg.norm(state.strain[-1, :3])
    swing = np.trace(turns) - tangent @ turns @ tangent
    return float(np.sqrt(np.trace(moves))), float(np.sqrt(max(swing, 0.0)))


def shape_covariances(arclength: Array, state: State, cov: Array) -> Array:
    """Second moments of the nodes of a time, over shapes drawn from the linearised estimate.

    Displacements and rotations are [R₀ᵀ(p − p₀), log(R₀ᵀR)]; strain is that of the estimate, and
    velocity that of the shape. Where the covariance is small the second moments equal it.

    Args:
        arclength: Nodes (N,), m.
        state: Mean (N,).
        cov: Joint covariance (D, D) of the nodes' unknowns, and of any that follow.

    Returns:
        Covariances (N, 18, 18) of [pose, strain, velocity], body frame. Source: equation (30).
    """
    count, dof = arclength.size, state.dof
    cov = cov[: count * dof, : count * dof]
    draws = _draws(count * dof) @ np.linalg.cholesky(cov).T
    draws = np.concatenate([draws, -draws]).reshape(-1, count, dof)
    own = np.diagonal(cov).reshape(count, dof)
    turn = np.sqrt(own[:, POSE][:, 3:].sum(axis=1))
    shares, error = np.minimum(1.0, _WOUND / turn), np.empty((*draws.shape[:2], DOF))
    for share in np.unique(shares):  # a node's shape is that of the body up to it
        at = np.flatnonzero(shares == share)
        inner = slice(at[-1] + 1)
        found = _errors(arclength[inner], state.take(inner), share, draws[:, inner])
        error[:, at] = found[:, at]
    moments = error.transpose(1, 2, 0) @ error.swapaxes(0, 1) / len(error)
    drawn = np.einsum("mni,mni->ni", draws, draws)[:, :DOF] / len(draws)
    scale = np.sqrt(own[:, :DOF] / drawn)  # removes the sampling error where all is linear
    return scale[:, :, None] * moments * scale[:, None, :]


def _errors(arclength: Array, state: State, share: float, draws: Array) -> Array:
    """Errors (M, N, 18) of a state whose poses err by a share of the steps (M, N, dof) drawn."""
    error, pose = np.empty((*draws.shape[:2], DOF)), _bent(arclength, state, share * draws)
    unturned = np.swapaxes(state.pose[:, :3, :3], -1, -2)
    base = state.pose[0, :3, 3] + draws[:, 0, :3] @ unturned[0]  # where it is winds up nothing
    pose[..., :3, 3] += (base - pose[:, 0, :3, 3])[:, None]
    error[..., :3] = _applied(unturned, pose[..., :3, 3] - state.pose[:, :3, 3])
    error[..., 3:6] = se3.so3_log(unturned @ pose[..., :3, :3])
    error[..., STRAIN] = draws[..., STRAIN]
    error[..., VELOCITY] = _velocities(state, pose, draws) - state.velocity
    return error


@lru_cache(maxsize=4)
def _draws(size: int) -> Array:
    """Standard normal draws (pairs, size), always the same."""
    return np.random.default_rng(0).standard_normal((_PAIRS, size))


def _bent(arclength: Array, state: State, step: Array) -> Array:
    """Poses (M, N, 4, 4) of the shapes after steps (M, N, dof) from a state.

    The errors of intervals (2') change with the step to first order; poses are built from them.
    """
    lengths = np.diff(arclength)
    pose = [state.pose[0] @ se3.exp(step[:, 0, POSE])]
    if not lengths.size:
        return np.stack(pose, axis=1)
    nodes = np.arange(lengths.size)[:, None] + np.arange(2)
    unit = np.ones((lengths.size, 6))
    error, jacobian, _ = static_steps(state, nodes, lengths, unit, 0.0 * unit)
    strain = state.strain + step[..., STRAIN]
    moved = [step[:, nodes[:, i], :12] for i in (0, 1)]
    start, end = (_applied(jacobian[:, :6, i], moved[i]) for i in (0, 1))
    slip = error[:, :6] + start + end
    for n, h in enumerate(lengths):
        onward = se3.exp(h * strain[:, n]) @ se3.exp(slip[:, n])
        pose.append(_within(pose[-1] @ onward, pose[0], _STRETCH * arclength[n + 1]))
    return np.stack(pose, axis=1)


def _velocities(state: State, pose: Array, step: Array) -> Array:
    """Velocities (M, N, 6) of shapes with poses (M, N, 4, 4), after steps (M, N, dof) from a state.

    Over an interval with relative pose X = exp(x), the velocity becomes Ad(X⁻¹) ϖ + r, where r is
    the right Jacobian of x times the rate of x. The rates change with the step to first order;
    velocities are built from them.
    """
    straight, bent = (se3.inverse(p[..., :-1, :, :]) @ p[..., 1:, :, :] for p in (state.pose, pose))
    turn = se3.log(se3.inverse(straight) @ bent)
    back, moved = se3.adjoint(se3.inverse(straight)), step[..., VELOCITY]
    carried = (back @ state.velocity[:-1, :, None])[..., 0]
    more = moved[:, 1:] - _applied(back, moved[:, :-1]) - _applied(se3.ad(carried), turn)
    rate = _applied(se3.right_jacobian_inverse(se3.log(straight)), more)
    own = (se3.right_jacobian(se3.log(bent)) @ rate[..., None])[..., 0]
    own += state.velocity[1:] - carried
    bent_back, velocity = se3.adjoint(se3.inverse(bent)), [state.velocity[0] + moved[:, 0]]
    for n in range(own.shape[1]):
        velocity.append((bent_back[:, n] @ velocity[-1][..., None])[..., 0] + own[:, n])
    return np.stack(velocity, axis=1)


def _applied(matrix: Array, vector: Array) -> Array:
    """Products (M, N, i) of matrices (N, i, j) of nodes and vectors (M, N, j)."""
    out: Array = (vector.swapaxes(0, 1) @ matrix.swapaxes(-1, -2)).swapaxes(0, 1)
    return out


def _within(pose: Array, base: Array, reach: float) -> Array:
    """Poses (M, 4, 4) with positions moved back to within `reach` of the base."""
    away = pose[:, :3, 3] - base[:, :3, 3]
    far = np.maximum(np.linalg.norm(away, axis=1) / reach, 1.0)
    pose[:, :3, 3] = base[:, :3, 3] + away / far[:, None]
    return pose
