"""Parts of the published estimator, to find which of them changes the size of an effect.

Its factors have variances per node, whatever span of time and arclength the node represents, and
simple residuals; the roll that a coil does not measure is dropped from a residual whose other
components depend on it. Source: Teetaert, Lilge, Burgner-Kahrs and Barfoot (2025), with the
settings of their real robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from glissando.errors import RobotFileError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.factors import Factors, Residuals
from glissando.model.grid import Grid, Index
from glissando.model.interpolation import Interpolation, Points
from glissando.model.noise import sqrt_information
from glissando.model.priors.prior import Prior
from glissando.model.priors.white_noise import BaseDensity, WhiteNoisePrior
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import CoilReadings, PoseReadings
from glissando.model.state import DOF, POSE, STRAIN, VELOCITY, State

PARTS = ("prior", "noise", "roll")
"""Parts that can be used: the prior with its rate, the sensors' noise, the coil's residual."""

RATE = 30.0
"""Time nodes a second of the published settings."""

_COMMON = 0.15  # factor on the variances of the prior
_Q1, _Q2, _Q3 = (_COMMON * np.repeat(pair, 3) for pair in ((30.0, 8e3), (0.8, 1e3), (0.8, 1e4)))
_BASE = (np.repeat([8e-5, 1e-3], 3), np.array([1e-2, 1e-2, 1e-2, 1e3, 1e3, 1e-4]), np.full(6, 1e2))
_NOISE = np.repeat([2e-5, 2.5e-3], 3)


class PublishedPrior(WhiteNoisePrior):
    """Kinematic prior in the published form, whose densities are used as variances per node."""

    def factors(
        self, grid: Grid, state: State, noise_state: State, times: slice
    ) -> Iterator[Factors]:
        """Factors along arclength, along time and at the base, as published."""
        k_count, n_count = grid.shape
        node = np.arange(k_count * n_count).reshape(k_count, n_count)
        nodes, flat = node[times], state.flatten()
        start = nodes[:, :-1].ravel()
        step = np.tile(np.diff(grid.arclength), len(nodes))
        cov = _step_covariances(
            step, STRAIN, self.psd_strain_arclength, self.psd_velocity_arclength
        )
        transport = np.tile(np.eye(DOF), (start.size, 1, 1))
        transport[:, VELOCITY, POSE] = se3.ad(noise_state.flatten().velocity[start])
        cov = transport @ cov @ np.swapaxes(transport, 1, 2)
        yield _step_factors(flat, np.stack([start, start + 1], axis=1), step, cov, STRAIN)
        if k_count > 1 and times.start < k_count - 1:
            start = node[:-1][times].ravel()
            step = np.repeat(np.diff(grid.time)[times], n_count)
            cov = _step_covariances(step, VELOCITY, self.psd_velocity_time, self.psd_strain_time)
            yield _step_factors(
                flat, np.stack([start, start + n_count], axis=1), step, cov, VELOCITY
            )
        yield self._base(np.ones(len(nodes)), flat, nodes[:, :1])

    def interpolate(
        self, grid: Grid, state: State, noise_state: State, points: Points
    ) -> Interpolation:
        """Interpolation between nodes without the covariance that it adds to that of the nodes."""
        per_node = copy(grid)
        for name in ("time_spans", "arclength_spans"):
            object.__setattr__(per_node, name, np.ones(getattr(grid, name).size))
        interpolation = super().interpolate(per_node, state, noise_state, points)
        return replace(interpolation, bridge=np.zeros_like(interpolation.cov))


@dataclass(frozen=True, kw_only=True)
class SmallAngleCoil(PoseReadings):
    """Coil whose residual is that of a pose without its last component, valid for small roll."""

    rows = 5

    def residual(self, at: State) -> Array:
        """First five components of log(T_meas⁻¹ T T_bc)."""
        return super().residual(at)[..., :5]

    def jacobian(self, at: State) -> Array:
        """First five rows of the Jacobian of a pose's residual."""
        pose = PoseReadings(
            time=self.time, arclength=self.arclength, values=self.values, cov=np.ones(6),
            mount=self.mount,
        )  # fmt: skip
        return pose.jacobian(at)[..., :5, :]


def published_prior(like: Prior) -> WhiteNoisePrior:
    """Published prior with the rest strain and base pose of another prior.

    Raises RobotFileError unless the other prior is kinematic, too.
    """
    if not isinstance(like, WhiteNoisePrior):
        raise RobotFileError("The published prior is kinematic; give a robot with such a prior.")
    base = BaseDensity(*(_COMMON * part for part in _BASE))
    return PublishedPrior(_Q1, _Q2, _Q3, _Q3, base, like.rest_strain, like.base_pose)


def published_readings(readings: Readings, parts: tuple[str, ...], rest: State) -> Readings:
    """Readings with the published noise, and of a coil with the published residual, by `parts`.

    The arbitrary constant roll that a tracker reports is chosen so that the first reading agrees
    with the tip of the robot at `rest` (N,).
    """
    rows = type(readings).rows
    if "noise" in parts:
        readings = replace(readings, cov=np.diag(_NOISE[:rows]))
    if "roll" not in parts or not isinstance(readings, CoilReadings):
        return readings
    relative = se3.inverse(readings.values[0]) @ rest.pose[-1]
    roll = np.arctan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])
    values = readings.values @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, roll]))
    return SmallAngleCoil(
        time=readings.time, arclength=readings.arclength, values=values, cov=readings.cov,
        mount=readings.mount, name=readings.name,
    )  # fmt: skip


def _step_covariances(step: Array, rate: slice, moving: Array, carried: Array) -> Array:
    """Covariances (M, 18, 18) of steps `step`: `rate`, strain or velocity, integrates to the pose.

    It and the other field are random walks with the densities (6,) `moving` and `carried`.
    """
    other = VELOCITY if rate == STRAIN else STRAIN
    cov, h = np.zeros((step.size, DOF, DOF)), step[:, None, None]
    cov[:, POSE, POSE] = h**3 / 3.0 * np.diag(moving)
    cov[:, POSE, rate] = cov[:, rate, POSE] = h**2 / 2.0 * np.diag(moving)
    cov[:, rate, rate], cov[:, other, other] = h * np.diag(moving), h * np.diag(carried)
    return cov


def _step_factors(flat: State, nodes: Index, step: Array, cov: Array, rate: slice) -> Factors:
    """Factors of steps between `nodes` (M, 2), with residuals of constant strain or velocity."""
    start, end = flat.take(nodes[:, 0]), flat.take(nodes[:, 1])
    h, eye = step[:, None, None], np.eye(6)
    xi = se3.log(se3.inverse(start.pose) @ end.pose)
    J_r_inverse = se3.right_jacobian_inverse(xi)
    along = start.strain if rate == STRAIN else start.velocity
    error = np.concatenate(
        [xi - step[:, None] * along, end.strain - start.strain, end.velocity - start.velocity], 1
    )
    jacobian = np.zeros((len(step), DOF, 2, DOF))
    jacobian[:, POSE, 0, POSE] = -J_r_inverse @ se3.adjoint(se3.inverse(end.pose) @ start.pose)
    jacobian[:, POSE, 1, POSE], jacobian[:, POSE, 0, rate] = J_r_inverse, -h * eye
    for field in (STRAIN, VELOCITY):
        jacobian[:, field, 0, field], jacobian[:, field, 1, field] = -eye, eye
    if rate == STRAIN:
        transport = h * se3.ad(start.strain)
        error[:, VELOCITY] += np.einsum("mij,mj->mi", transport, start.velocity)
        jacobian[:, VELOCITY, 0, VELOCITY] += transport
        jacobian[:, VELOCITY, 0, STRAIN] = -h * se3.ad(start.velocity)
    return Factors(nodes, slice(0, DOF), jacobian, Residuals(error, sqrt_information(cov)))
