"""The separable prior (2b) by its definition: one dense Gaussian over any points of (s, t).

Small deviations from a still rod of constant strain ε. At one instant x(s) = [pose deviation δ in
the body frame, strain deviation] obeys

    x(0) ~ N(0, diag(base_pose_var, base_strain_var)),   δ' = −ad(ε) δ + δε,   δε' = white noise,

`psd` the noise's density per metre, (6,) or (S, 6) for the S segments that meet at S−1 joints in
increasing order, and at a joint (s_j, jump) the strain also jumps by an
independent amount of variance `jump` (6,) just before s_j, so that the value at s_j has it. In time
all of it varies as the Matérn-3/2 process k of scale ℓ: cov(x(s,t), x(s',t')) = k(t−t') K(s,s').
About a still rod the body's velocity is dδ/dt, so a point's 24 numbers are [x, dx/dt], in the order
[pose, strain, velocity, strain rate], and their covariance is matern(t−t') ⊗ K(s,s').
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from glissando.model.factors import Factors
from oracles import dense

Array = NDArray[np.float64]
Joints = Iterable[tuple[float, Array]]


def matern(lag: float, time_scale: float) -> Array:
    """Return cov([r, r'](t), [r, r'](t − lag)) (2, 2) of the unit Matérn-3/2 process.

    Its entries are k(lag) and its derivatives: r(t') differentiates once with a minus sign.
    """
    rate = np.sqrt(3.0) / time_scale
    fade = np.exp(-rate * abs(lag))
    k = (1.0 + rate * abs(lag)) * fade
    slope = -(rate**2) * lag * fade
    bend = -(rate**2) * (1.0 - rate * abs(lag)) * fade
    return np.array([[k, -slope], [slope, -bend]])


def space_covariance(
    s: float,
    s2: float,
    *,
    psd: Array,
    base_pose_var: Array,
    base_strain_var: Array,
    rest_strain: Array,
    joints: Joints = (),
) -> Array:
    """Return K(s, s2) = cov(x(s), x(s2)) (12, 12), x = [pose deviation, strain deviation].

    All that happens up to the nearer place is carried on to each of the two: the base, the
    noise on the way and the joints passed.
    """
    near = min(s, s2)
    psd = np.asarray(psd, dtype=float)

    def onward(start: float, end: float) -> Array:
        return dense.pair_transition(rest_strain, end - start)

    base = block_diag(np.diag(base_pose_var), np.diag(base_strain_var))
    k = onward(0.0, s) @ base @ onward(0.0, s2).T
    joints = tuple(joints)
    bounds = [0.0, *(place for place, _ in joints), np.inf] if psd.ndim == 2 else [0.0, np.inf]
    for start, end, density in zip(bounds[:-1], bounds[1:], np.atleast_2d(psd), strict=True):
        if start < near:
            stop = min(end, near)
            noise = dense.pair_covariance(rest_strain, stop - start, density)
            k = k + onward(stop, s) @ noise @ onward(stop, s2).T
    for place, jump in joints:
        if place <= near:
            loose = block_diag(np.zeros((6, 6)), np.diag(jump))
            k = k + onward(place, s) @ loose @ onward(place, s2).T
    return k


def joint(
    points: Sequence[tuple[float, float]],
    *,
    psd: Array,
    base_pose_var: Array,
    base_strain_var: Array,
    time_scale: float,
    rest_strain: Array,
    joints: Joints = (),
) -> Array:
    """Return the covariance (24 P, 24 P) of P points (s, t), point after point."""
    joints = tuple(joints)
    blocks = [
        [
            np.kron(
                matern(t - t2, time_scale),
                space_covariance(
                    s,
                    s2,
                    psd=psd,
                    base_pose_var=base_pose_var,
                    base_strain_var=base_strain_var,
                    rest_strain=rest_strain,
                    joints=joints,
                ),
            )
            for s2, t2 in points
        ]
        for s, t in points
    ]
    return np.block(blocks)


def condition(cov: Array, h: Array, y: Array, r: Array) -> tuple[Array, Array]:
    """Return mean and covariance of x ~ N(0, cov) once y = h x + noise of covariance r is read."""
    gain = np.linalg.solve(h @ cov @ h.T + r, h @ cov).T
    return gain @ y, cov - gain @ h @ cov


def information(batches: Iterable[Factors], nodes: int) -> Array:
    """Return the information matrix (24 nodes, 24 nodes) of factors over nodes of 24 numbers."""
    out = np.zeros((24 * nodes, 24 * nodes))
    for batch in batches:
        for row, at_node in enumerate(spread(batch, nodes)):
            white = batch.terms.sqrt_info[row] @ at_node
            out += white.T @ white
    return out


def spread(batch: Factors, nodes: int) -> Array:
    """Return a batch's Jacobian (M, r, dof nodes) with respect to every node of the grid."""
    return dense.spread(batch, nodes, max(24, batch.jacobian.shape[-1]))
