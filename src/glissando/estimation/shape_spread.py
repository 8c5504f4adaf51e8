"""How far shapes spread: covariances of a belief that is too wide for a tangent space.

A linearised belief moves poses straight on. A body whose strains are hardly known bends instead:
its points stay on the body, no farther from the base than it reaches, and turns wrap. Shapes are
drawn from the belief, built from the base outwards, and their second moments about the mean taken.
A belief so wide that draws would wind up is narrowed until it says no more than "anywhere".
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.priors.steps import static_steps
from glissando.model.state import DOF, POSE, STRAIN, State

_WOUND = float(np.pi)  # rad: known less well, a body points anywhere; more would wind it up

_STRETCH = 1.1  # of its length: as far as a body reaches
_PAIRS = 256  # of draws, opposite to each other
_UNMOVED = np.eye(4)


class ShapeSpread(StateEstimate):
    """An estimate whose covariance is the second moment of shapes: their arcs are in it."""

    @staticmethod
    def of(estimate: StateEstimate) -> ShapeSpread:
        """The same, what arcs add to positions being in its covariance (30)."""
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
    """An estimate at places (…) with the spread of shapes at the nodes, straight between them.

    Each node's covariance is of its own body frame, and so nearly that of a place beside it.

    Args:
        arclength: Nodes (N,), m.
        nodes: What is believed there (N,), with the spread of shapes.
        place: Where it is asked for, m.
        at: What the linearised belief says there.
    """
    cov = between_nodes(arclength, nodes.cov, place)
    return ShapeSpread(at.pose, at.strain, at.velocity, cov)


def between_nodes(arclength: Array, cov: Array, place: Array) -> Array:
    """Covariances of places (…) between those (N, d, d) of the nodes (N,), straight."""
    upper = np.clip(np.searchsorted(arclength, place), 1, arclength.size - 1)
    share = (place - arclength[upper - 1]) / (arclength[upper] - arclength[upper - 1])
    share = np.asarray(share)[..., None, None]
    out: Array = (1.0 - share) * cov[upper - 1] + share * cov[upper]
    return out


def tip_spread(state: State, cov: Array) -> tuple[float, float]:
    """RMS displacement (m) and swing (rad) of the tip by the joint covariance (D, D) of a time.

    The swing turns the tangent. A turn about the tangent, which a coil does not read, moves no
    point of the body.

    Args:
        state: Mean (N,).
        cov: Joint covariance of its numbers, and of whatever follows them.
    """
    first = (state.pose.shape[0] - 1) * state.dof
    moves, turns = (cov[at : at + 3, at : at + 3] for at in (first, first + 3))
    tangent = state.strain[-1, :3] / np.linalg.norm(state.strain[-1, :3])
    swing = np.trace(turns) - tangent @ turns @ tangent
    return float(np.sqrt(np.trace(moves))), float(np.sqrt(max(swing, 0.0)))


def shape_covariances(arclength: Array, state: State, cov: Array) -> Array:
    """Second moments of the nodes of a time, of shapes drawn from its linearised belief.

    Displacements and turns are those of [R₀ᵀ(p − p₀), log(R₀ᵀR)]; strain and velocity are as the
    belief has them. Where the belief is narrow these are its own covariances.

    Args:
        arclength: Nodes (N,), m.
        state: Mean (N,).
        cov: Joint covariance (D, D) of the nodes' numbers, and of whatever follows them.

    Returns:
        Covariances (N, 18, 18) of [pose, strain, velocity], body frame. Source: equation (30).
    """
    count, dof = arclength.size, state.dof
    cov = cov[: count * dof, : count * dof]
    draws = _draws(count * dof) @ np.linalg.cholesky(cov).T
    draws = np.concatenate([draws, -draws]).reshape(-1, count, dof)
    turn = np.sqrt(np.diagonal(cov)[(count - 1) * dof + 3 : (count - 1) * dof + 6].sum())
    pose = _bent(arclength, state, min(1.0, _WOUND / turn) * draws)
    error = np.empty((*draws.shape[:2], DOF))
    unturned = np.swapaxes(state.pose[:, :3, :3], -1, -2)
    error[..., :3] = np.einsum("nij,mnj->mni", unturned, pose[..., :3, 3] - state.pose[:, :3, 3])
    error[..., 3:6] = se3.so3_log(unturned @ pose[..., :3, :3])
    error[..., 6:] = draws[..., 6:DOF]
    moments = np.einsum("mni,mnj->nij", error, error) / len(error)
    drawn = np.einsum("mni,mni->ni", draws, draws)[:, :DOF] / len(draws)
    own = np.diagonal(cov).reshape(count, dof)[:, :DOF]
    scale = np.sqrt(own / drawn)  # so that nothing of the draws' chance shows where all is linear
    return scale[:, :, None] * moments * scale[:, None, :]


@lru_cache(maxsize=4)
def _draws(size: int) -> Array:
    """Standard normal draws (pairs, size), always the same."""
    return np.random.default_rng(0).standard_normal((_PAIRS, size))


def _bent(arclength: Array, state: State, step: Array) -> Array:
    """Poses (M, N, 4, 4) of the shapes to which steps (M, N, dof) of a state lead.

    The errors of intervals (2') move as the step says to first order; poses are built from them.
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
    start, end = (np.einsum("nij,mnj->mni", jacobian[:, :6, i], moved[i]) for i in (0, 1))
    slip = error[:, :6] + start + end
    for n, h in enumerate(lengths):
        onward = se3.exp(h * strain[:, n]) @ se3.exp(slip[:, n])
        pose.append(_within(pose[-1] @ onward, pose[0], _STRETCH * arclength[n + 1]))
    return np.stack(pose, axis=1)


def _within(pose: Array, base: Array, reach: float) -> Array:
    """Poses (M, 4, 4) brought back to where a body of that length reaches from its base."""
    away = pose[:, :3, 3] - base[:, :3, 3]
    far = np.maximum(np.linalg.norm(away, axis=1) / reach, 1.0)
    pose[:, :3, 3] = base[:, :3, 3] + away / far[:, None]
    return pose
