"""How far an estimate is from truth, and whether its confidence is true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from glissando.errors import SensorError
from glissando.estimation.posterior import Posterior, StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.interpolation import sort_points
from glissando.model.sensors.parameters import corrected
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import (
    CoilReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
)
from glissando.model.state import State

_JUDGES = (PoseReadings, CoilReadings, PositionReadings, OrientationReadings)


@dataclass(frozen=True)
class Errors:
    """Errors of an estimate at M truth samples in order of `time`; what a stream lacks is NaN.

    `position` (M,) metres, `rotation` (M,) radians; `nees_position` and `nees_rotation` (M,) the
    squared errors in units of their covariance, of 3 and `dof_rotation` degrees of freedom (2 for a
    coil, whose roll is not seen).
    """

    name: str
    arclength: Array
    position: Array
    rotation: Array
    nees_position: Array
    nees_rotation: Array
    dof_rotation: int = 3
    time: Array = field(default_factory=lambda: np.zeros(0))

    def summary(self) -> dict[str, float | None]:
        """RMSEs, NEES per degree of freedom, and the share inside the 95 % ellipsoid."""
        inside = np.where(
            np.isnan(self.nees_position), np.nan, self.nees_position <= chi2.ppf(0.95, 3)
        )
        return {
            "position_rmse": _rms(self.position),
            "rotation_rmse": _rms(self.rotation),
            "nees_position": _mean(self.nees_position / 3.0),
            "coverage95_position": _mean(inside),
            "nees_rotation": _mean(self.nees_rotation / self.dof_rotation),
        }


def _mean(values: Array) -> float | None:
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else None


def _rms(values: Array) -> float | None:
    square = _mean(values**2)
    return None if square is None else float(np.sqrt(square))


class Answers(Protocol):
    """What can be asked for the state at any arclength and time: a posterior, a smoother."""

    def at(self, arclength: ArrayLike, time: ArrayLike) -> StateEstimate:
        """State and covariance at points (M,)."""


def errors_against(posterior: Answers, truth: Readings) -> Errors:
    """Errors of the estimate at every sample of a truth stream.

    Streams of pose, coil, position or orientation will do. The truth's own covariance is added to
    the posterior's before the error is measured in it. Raises SensorError for other kinds.
    """
    if not isinstance(truth, _JUDGES):
        raise SensorError(
            f"{truth.label}: a {type(truth).__name__} cannot be truth; give poses, coils, "
            f"positions or orientations."
        )
    truth = truth.select(np.argsort(truth.time, kind="stable"))
    found = posterior.at(truth.arclength, truth.time)
    at = found.pose @ truth.mount
    count = len(truth)
    position, nees, rotation, nees_rotation = np.full((4, count), np.nan)
    dof = 2 if isinstance(truth, CoilReadings) else 3
    if not isinstance(truth, OrientationReadings):
        where = truth.values[:, :3, 3] if truth.values.ndim == 3 else truth.values
        miss = np.einsum("mji,mj->mi", at[:, :3, :3], where - at[:, :3, 3])
        lever = se3.adjoint(se3.inverse(truth.mount))[:3]
        own = truth.cov[..., :3, :3]
        if isinstance(truth, PositionReadings):  # stated in the world frame
            own = np.swapaxes(at[:, :3, :3], -1, -2) @ own @ at[:, :3, :3]
        cov = lever @ found.cov[:, :6, :6] @ lever.T + own
        position = np.linalg.norm(miss, axis=1)
        nees = np.einsum("mi,mi->m", miss, np.linalg.solve(cov, miss[..., None])[..., 0])
    if truth.values.ndim == 3:
        miss = _turned(at[:, :3, :3], truth)
        own = truth.cov[..., -dof:, -dof:]
        turn = truth.mount[:3, :3].T[:dof]
        cov = turn @ found.cov[:, 3:6, 3:6] @ turn.T + own
        rotation = np.linalg.norm(miss, axis=1)
        nees_rotation = np.einsum("mi,mi->m", miss, np.linalg.solve(cov, miss[..., None])[..., 0])
    found_out = position, rotation, nees, nees_rotation, dof, truth.time
    return Errors(truth.label, truth.arclength, *found_out)


def innovations(posterior: Posterior, readings: Readings) -> Array:
    """Squared innovations (M,) of readings that were used, in units of their covariance.

    The innovation of a reading is its distance from what all others foretell; for residual e with
    covariance R and posterior spread H P Hᵀ its square is eᵀ (R − H P Hᵀ)⁻¹ e, of as many degrees
    of freedom as a reading has rows, and no reading need be left out to find it. Unknowns are taken
    at their estimates and as if they were sure.
    """
    middle = [(u, values[len(values) // 2]) for u, values in posterior.sensor_parameters]
    readings = corrected(readings, [replace(u, value=value) for u, value in middle])
    grid = posterior.grid
    readings = replace(
        readings,
        arclength=np.clip(readings.arclength, grid.arclength[0], grid.arclength[-1]),
        time=np.clip(readings.time, grid.time[0], grid.time[-1]),
    )
    found = posterior.at(readings.arclength, readings.time)
    at = State(found.pose, found.strain, found.velocity)
    residual, slope = readings.residual(at), readings.jacobian(at)
    open_ = np.zeros_like(found.cov)
    for points in sort_points(grid, readings.arclength, readings.time):
        state = posterior.state
        open_[points.rows] = posterior.prior.interpolate(grid, state, state, points).cov
    turned = np.swapaxes(slope, -1, -2)
    cov = readings.cov + slope @ (2.0 * open_ - found.cov) @ turned
    return np.einsum("mi,mi->m", residual, np.linalg.solve(cov, residual[..., None])[..., 0])


def _turned(estimated: Array, truth: Readings) -> Array:
    """Rotation vectors (M, 3) from estimated to true orientation in the sensor's frame.

    For a coil (M, 2): the tilt of its axis, the least turn that takes one onto the other.
    """
    apart = np.swapaxes(estimated, -1, -2) @ truth.values[:, :3, :3]
    if not isinstance(truth, CoilReadings):
        return se3.so3_log(apart)
    sine = np.hypot(apart[:, 0, 2], apart[:, 1, 2])
    angle = np.arctan2(sine, apart[:, 2, 2])
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)
    return scale[:, None] * np.stack([-apart[:, 1, 2], apart[:, 0, 2]], axis=-1)


def joined(errors: Sequence[Errors]) -> Errors:
    """Errors of one stream, one part after another."""
    return Errors(
        errors[0].name,
        np.concatenate([e.arclength for e in errors]),
        np.concatenate([e.position for e in errors]),
        np.concatenate([e.rotation for e in errors]),
        np.concatenate([e.nees_position for e in errors]),
        np.concatenate([e.nees_rotation for e in errors]),
        errors[0].dof_rotation,
        np.concatenate([e.time for e in errors]),
    )


def pool(errors: Sequence[Errors]) -> Errors:
    """All samples of all sites as one; rotations count as of three degrees of freedom."""
    alike = [replace(e, nees_rotation=e.nees_rotation * (3.0 / e.dof_rotation)) for e in errors]
    return replace(joined(alike), name="overall", dof_rotation=3)
