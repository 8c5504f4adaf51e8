"""Second opinion from GTSAM on the published white-noise prior along arclength.

GTSAM's white-noise-on-acceleration (WNOA) factor is the "published form" of the prior when time is
read as arclength and velocity as strain: the error of an interval of length h is
``[log(T0^-1 T1) - h strain0 ; Jr^-1(log(T0^-1 T1)) strain1 - strain0]`` and its covariance that of
six independent integrated white noises. Everything here crosses the border in the order
[linear, angular]; GTSAM keeps [angular, linear] within. A pose T_wb takes body coordinates to the
world and is perturbed on the right, T exp(delta), which is also how GTSAM moves a ``Pose3``.

The pose columns of GTSAM's Jacobian are exact in the first six rows; in the last six they stop at
the second order in log(T0^-1 T1), so compare those with a tolerance that grows with h cubed.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# [linear, angular] <-> [angular, linear]; a permutation that is its own inverse.
SWAP6 = np.array([3, 4, 5, 0, 1, 2])
SWAP12 = np.concatenate([SWAP6, SWAP6 + 6])
SWAP24 = np.concatenate([SWAP12, SWAP12 + 12])

# A rod whose posterior has the ten figures of the refinement table to the printed digit. The
# constants were fitted to that table: they are one choice out of many, not a material.
STRAIN_PSD = (5.1e-4, 5.1e-4, 5.1e-4, 4.0, 4.0, 0.45)  # strain^2 per metre
BASE_STRAIN_VARIANCE = (8e-6, 8e-6, 8e-6, 14.0, 14.0, 1e-8)
TIP_STD = (7e-4, 7e-4, 7e-4, np.deg2rad(0.4), np.deg2rad(0.4), 1e3)  # the roll is not observed
BASE_POSE_STD = 1e-7
# Posterior position standard deviation at mid-length in millimetres, by number of nodes.
PUBLISHED_MM = {5: 16.12, 9: 13.46, 17: 12.87, 33: 12.73, 65: 12.69}


def _pose_key(index: int) -> int:
    return gtsam.symbol("x", index)


def _strain_key(index: int) -> int:
    return gtsam.symbol("e", index)


def _vector(six: ArrayLike) -> Array:
    """Exchange the halves of a six-vector."""
    swapped: Array = np.asarray(six, dtype=np.float64)[SWAP6]
    return swapped


def _state(index: int, arclength: float) -> gtsam.StateData:
    return gtsam.StateData(_pose_key(index), _strain_key(index), arclength)


def _motion_factor(index: int, h: float, psd: ArrayLike) -> gtsam.WnoaMotionFactorPose3:
    """Return the factor between nodes `index` and `index + 1`, h apart."""
    first, second = _state(index, index * h), _state(index + 1, (index + 1) * h)
    return gtsam.WnoaMotionFactorPose3(first, second, _vector(psd))


def wnoa_error_and_jacobians(
    T0: ArrayLike, strain0: ArrayLike, T1: ArrayLike, strain1: ArrayLike, h: float
) -> tuple[Array, Array]:
    """Return the unweighted error of one interval and its Jacobian.

    Poses are 4x4, strains six-vectors. The error has 12 rows, [pose, strain]; the Jacobian is
    12x24 with columns [pose 0, strain 0, pose 1, strain 1], every block [linear, angular].
    """
    factor = _motion_factor(0, h, np.ones(6))
    blocks = [np.zeros((12, 6)) for _ in range(4)]  # filled in place
    error = factor.evaluateError(
        gtsam.Pose3(np.asarray(T0)),
        _vector(strain0),
        gtsam.Pose3(np.asarray(T1)),
        _vector(strain1),
        *blocks,
    )
    return np.asarray(error)[SWAP12], np.hstack(blocks)[np.ix_(SWAP12, SWAP24)]


def wnoa_covariance(psd: ArrayLike, h: float) -> Array:
    """Return the 12x12 covariance that GTSAM gives that error.

    `psd` is the diagonal of the power spectral density, [linear, angular]; the order of rows is
    that of `wnoa_error_and_jacobians`.
    """
    noise = _motion_factor(0, h, psd).noiseModel()
    if not isinstance(noise, gtsam.noiseModel.Gaussian):
        raise TypeError(f"expected a Gaussian noise model, got {type(noise).__name__}")
    covariance: Array = np.asarray(noise.covariance())[np.ix_(SWAP12, SWAP12)]
    return covariance


def wnoa_interpolate(
    T0: ArrayLike,
    strain0: ArrayLike,
    T1: ArrayLike,
    strain1: ArrayLike,
    psd: ArrayLike,
    h: float,
    u: float,
) -> tuple[Array, Array]:
    """Return the pose (4x4) and strain at arclength u from node 0, 0 <= u <= h.

    The mean does not depend on `psd` as long as that is diagonal; GTSAM asks for it all the same.
    """
    values = _values([T0, T1], [strain0, strain1])
    query = _state(2, u)
    found = gtsam.updateInterpValuesPose3(
        gtsam.NonlinearFactorGraph(), values, {_state(0, 0.0), _state(1, h)}, {query}, _vector(psd)
    )
    return found.atPose3(query.pose).matrix(), _vector(found.atVector6(query.velocity))


def _values(poses: Sequence[ArrayLike], strains: Sequence[ArrayLike]) -> gtsam.Values:
    """Return GTSAM's values with node i holding pose i and strain i."""
    values = gtsam.Values()
    for i, (pose, strain) in enumerate(zip(poses, strains, strict=True)):
        values.insert(_pose_key(i), gtsam.Pose3(np.asarray(pose)))
        values.insert(_strain_key(i), _vector(strain))
    return values


def midlength_covariance(
    nodes: int,
    *,
    psd: ArrayLike = STRAIN_PSD,
    base_strain_variance: ArrayLike = BASE_STRAIN_VARIANCE,
    tip_std: ArrayLike = TIP_STD,
    curvature: float = 2.0,
    length: float = 0.70,
) -> Array:
    """Return the 6x6 posterior covariance of the pose in the middle of a bent rod.

    The rod has constant curvature about body x, a known base pose, a prior on its base strain and
    one pose reading at its tip; all is linearised at that shape, where every error is zero.
    `nodes` is odd, so that one node lies in the middle.
    """
    if nodes < 3 or nodes % 2 == 0:
        raise ValueError(f"nodes must be odd and at least 3, got {nodes}")
    h = length / (nodes - 1)
    strain = np.array([0.0, 0.0, 1.0, curvature, 0.0, 0.0])
    poses = [gtsam.Pose3.Expmap(i * h * _vector(strain)) for i in range(nodes)]
    values = _values([pose.matrix() for pose in poses], [strain] * nodes)
    diagonal = gtsam.noiseModel.Diagonal
    base = gtsam.noiseModel.Isotropic.Sigma(6, BASE_POSE_STD)
    spread = diagonal.Variances(_vector(base_strain_variance))
    reading = diagonal.Sigmas(_vector(tip_std))
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.PriorFactorPose3(_pose_key(0), poses[0], base))
    graph.add(gtsam.PriorFactorVector6(_strain_key(0), _vector(strain), spread))
    for i in range(nodes - 1):
        graph.add(_motion_factor(i, h, psd))
    graph.add(gtsam.PriorFactorPose3(_pose_key(nodes - 1), poses[-1], reading))
    marginals = gtsam.Marginals(graph, values)
    middle = np.asarray(marginals.marginalCovariance(_pose_key(nodes // 2)))
    covariance: Array = middle[np.ix_(SWAP6, SWAP6)]
    return covariance


def midlength_std(
    nodes: int,
    *,
    psd: ArrayLike = STRAIN_PSD,
    base_strain_variance: ArrayLike = BASE_STRAIN_VARIANCE,
    tip_std: ArrayLike = TIP_STD,
    curvature: float = 2.0,
    length: float = 0.70,
) -> float:
    """Return the position standard deviation at mid-length in metres.

    It is the root of the trace of the 3x3 position covariance; see `midlength_covariance`.
    """
    covariance = midlength_covariance(
        nodes,
        psd=psd,
        base_strain_variance=base_strain_variance,
        tip_std=tip_std,
        curvature=curvature,
        length=length,
    )
    return float(np.sqrt(np.trace(covariance[:3, :3])))
