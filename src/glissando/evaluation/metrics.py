"""Errors of an estimate against truth, and innovations of its readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from glissando.errors import SensorError
from glissando.estimation.given import require_kind
from glissando.estimation.posterior import Posterior
from glissando.estimation.reading_fit import fit_of
from glissando.estimation.reading_noise import StateSource, reading_covariance
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.quantiles import chi_square_of, chi_square_quantile
from glissando.model.sensors.readings import Readings
from glissando.model.sensors.sensors import (
    CoilReadings,
    OrientationReadings,
    PoseReadings,
    PositionReadings,
)
from glissando.model.short_repr import ShortRepr
from glissando.model.state import State

_LEAST_SHARE = 1e-5  # least share of a reading's variance not explained by the estimate
_LEAST_VARIANCE = 1e-18  # m², added to the variance of an estimate, which may be zero
_TRUTH = (PoseReadings, CoilReadings, PositionReadings, OrientationReadings)


@dataclass(frozen=True)
class Errors(ShortRepr):
    """Errors of an estimate at M truth samples; quantities that a stream lacks are NaN.

    Attributes:
        name: Name of the truth stream.
        arclength: Arclengths (M,) of the samples, m.
        position: Position errors (M,), m.
        rotation: Rotation errors (M,), rad.
        nees_position: Squared position errors (M,) in units of their covariance, 3 degrees of
            freedom.
        nees_rotation: Squared rotation errors (M,) in units of their covariance.
        sigmas: Position errors (M,) in standard deviations of the estimate alone, as tubes are
            drawn; the noise of truth is not included and increases them.
        dof_rotation: Degrees of freedom of rotation errors: 3, or 2 for a coil, whose roll is
            unknown.
        time: Times (M,) of the samples, s.
        white_position: Whitened position errors (M, 3); empty (0, 3) if not kept.
        white_rotation: Whitened rotation errors (M, r); empty if not kept.
    """

    name: str
    arclength: Array
    position: Array
    rotation: Array
    nees_position: Array
    nees_rotation: Array
    sigmas: Array
    dof_rotation: int = 3
    time: Array = field(default_factory=lambda: np.zeros(0))
    white_position: Array = field(default_factory=lambda: np.zeros((0, 3)))
    white_rotation: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def summary(self) -> dict[str, float | None]:
        """RMSEs, NEES per degree of freedom, share inside the 95 % ellipsoid; None if unknown."""
        inside = np.where(
            np.isnan(self.nees_position), np.nan, self.nees_position <= chi_square_quantile(0.95, 3)
        )
        return {
            "position_rmse": _rms(self.position),
            "rotation_rmse": _rms(self.rotation),
            "nees_position": _mean(self.nees_position / 3.0),
            "coverage95_position": _mean(inside),
            "nees_rotation": _mean(self.nees_rotation / self.dof_rotation),
        }

    def site_summary(self) -> dict[str, Any]:
        """Name, mean arclength, m, and number of samples of the site, with `summary`."""
        return {
            "name": self.name,
            "arclength": float(np.mean(self.arclength)),
            "samples": int(self.arclength.size),
            **self.summary(),
        }


def _mean(values: Array) -> float | None:
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else None


def _rms(values: Array) -> float | None:
    square = _mean(values**2)
    return None if square is None else float(np.sqrt(square))


def errors_against(estimate: StateSource, truth: Readings) -> Errors:
    """Errors of an estimate at every sample of a truth stream, in order of time.

    Args:
        estimate: A posterior or a smoother.
        truth: Poses, coils, positions or orientations; their covariance is included in the NEES.

    Raises:
        SensorError: The truth is of another kind, or in a channel without an arclength.
    """
    require_kind(truth, Readings, "truth", "give one stream of Readings, the estimate first")
    if not hasattr(estimate, "at"):
        require_kind(estimate, Posterior, "estimate", "give what estimate() returns")
    if not isinstance(truth, _TRUTH):
        raise SensorError(
            f"{truth.label}: a {type(truth).__name__} cannot be truth; give poses, coils, "
            f"positions or orientations."
        )
    if truth.channel is not None:
        raise SensorError(
            f"{truth.label}: truth in a channel is beside the backbone, at no arclength of it; "
            f"place it by the estimate, or name other truth."
        )
    truth = truth.select(np.argsort(truth.time, kind="stable"))
    body = estimate.at(truth.arclength, truth.time)
    at = body.pose @ truth.mount
    position, nees_position, sigmas, rotation, nees_rotation = np.full((5, len(truth)), np.nan)
    dof, white = 2 if isinstance(truth, CoilReadings) else 3, [np.zeros((0, 3)), np.zeros((0, 3))]
    if not isinstance(truth, OrientationReadings):
        where = truth.values[:, :3, 3] if truth.values.ndim == 3 else truth.values
        error = np.einsum("mji,mj->mi", at[:, :3, :3], where - at[:, :3, 3])
        truth_cov = truth.cov[..., :3, :3]
        if isinstance(truth, PositionReadings):  # stated in the world frame
            truth_cov = np.swapaxes(at[:, :3, :3], -1, -2) @ truth_cov @ at[:, :3, :3]
        cov = body.position_covariance(truth.mount)
        position, nees_position = np.linalg.norm(error, axis=1), _squared(error, cov + truth_cov)
        white[0] = _white(error, cov + truth_cov)
        sigmas = np.sqrt(_squared(error, cov + _LEAST_VARIANCE * np.eye(3)))
    if truth.values.ndim == 3:
        error = _rotation_error(at[:, :3, :3], truth)
        truth_cov = truth.cov[..., -dof:, -dof:]
        turn = np.swapaxes(truth.mount[..., :3, :3], -1, -2)[..., :dof, :]
        cov = turn @ body.cov[:, 3:6, 3:6] @ np.swapaxes(turn, -1, -2) + truth_cov
        rotation, nees_rotation = np.linalg.norm(error, axis=1), _squared(error, cov)
        white[1] = _white(error, cov)
    numbers = position, rotation, nees_position, nees_rotation, sigmas
    return Errors(truth.label, truth.arclength, *numbers, dof, truth.time, *white)


def prediction_scores(estimate: StateSource, readings: Readings) -> Array:
    """Mahalanobis distances (M,) of readings from their prediction by an estimate.

    Args:
        estimate: A posterior or a smoother.
        readings: Readings that the estimate has not used.
    """
    body = estimate.at(readings.arclength, readings.time)
    at = State(body.pose, body.strain, body.velocity)
    J_r_x = readings.jacobian(at)
    own = reading_covariance(estimate, readings, at, J_r_x)
    cov = J_r_x @ body.cov @ np.swapaxes(J_r_x, -1, -2) + own
    return np.sqrt(_squared(readings.residual(at), cov))


def _squared(error: Array, cov: Array) -> Array:
    """Squared Mahalanobis norms (M,) of errors (M, r)."""
    return np.einsum("mi,mi->m", error, np.linalg.solve(cov, error[..., None])[..., 0])


def _white(error: Array, cov: Array) -> Array:
    """Whitened errors (M, r); empty (0, r) if a given covariance is not positive definite."""
    try:
        root = np.linalg.cholesky(np.broadcast_to(cov, (*error.shape, error.shape[1])))
    except np.linalg.LinAlgError:
        return np.zeros((0, error.shape[1]))
    return np.asarray(np.linalg.solve(root, error[..., None])[..., 0])


def innovations(posterior: Posterior, readings: Readings) -> Array:
    """Squared innovations (M,) of readings that were used, in units of their covariance.

    The innovation of a reading is its difference from the prediction by all others. For a residual
    e with covariance R and posterior covariance H P Hᵀ its square is eᵀ (R − H P Hᵀ)⁻¹ e, with as
    many degrees of freedom as a reading has rows; no reading has to be left out. The share of a
    row's variance that remains in R − H P Hᵀ is at least 1e-5, since smaller shares are determined
    by rounding and the solver's tolerance; the square is thus never negative.

    Args:
        posterior: The estimate.
        readings: A stream used by the estimate, corrected for known sensor parameters.
    """
    return fit_of(posterior, readings).squared(True, _LEAST_SHARE)


def _rotation_error(estimated: Array, truth: Readings) -> Array:
    """Rotation vectors (M, 3) from estimated to true orientation in the sensor's frame.

    For a coil (M, 2): the tilt of its axis, by the smallest rotation between the axes.
    """
    apart = np.swapaxes(estimated, -1, -2) @ truth.values[:, :3, :3]
    if not isinstance(truth, CoilReadings):
        return se3.so3_log(apart)
    sine = np.hypot(apart[:, 0, 2], apart[:, 1, 2])
    angle = np.arctan2(sine, apart[:, 2, 2])
    scale = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)
    return scale[:, None] * np.stack([-apart[:, 1, 2], apart[:, 0, 2]], axis=-1)


def joined(errors: Sequence[Errors]) -> Errors:
    """Concatenate errors of one stream; the name is that of the first part."""
    arrays = (
        "arclength", "position", "rotation", "nees_position", "nees_rotation", "time", "sigmas",
    )  # fmt: skip
    parts: dict[str, Any] = {n: np.concatenate([getattr(e, n) for e in errors]) for n in arrays}
    for name in ("white_position", "white_rotation"):
        each = [getattr(e, name) for e in errors]
        alike = len({white.shape[1] for white in each}) == 1
        parts[name] = np.concatenate(each) if alike else np.zeros((0, 3))
    return replace(errors[0], **parts)


def pool(errors: Sequence[Errors]) -> Errors:
    """Pool samples of all sites; rotation NEES are converted to the most degrees of freedom."""
    dof = max(e.dof_rotation for e in errors)
    alike = [
        replace(e, nees_rotation=chi_square_of(e.nees_rotation, e.dof_rotation, dof))
        for e in errors
    ]
    return replace(joined(alike), name="overall", dof_rotation=dof)
