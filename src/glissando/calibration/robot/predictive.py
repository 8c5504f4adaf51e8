"""Predictive log-likelihood of truth given an estimate, with the truth's frame and mounts.

The frame of the truth and the mounts of its bodies are seldom known well; they are calibrated by
maximising the likelihood of the truth given the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glissando.estimation.posterior import Posterior
from glissando.estimation.state_estimate import StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.parameter_jacobians import by_parameters
from glissando.model.sensors.parameters import SIZES, SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_PRIOR_STD = {"frame": (0.005, 0.03), "mount": (0.005, 0.05)}  # m, rad
_ROUNDS = 2  # Gauss–Newton steps on the constants, from those of the last evaluation
APART = 0.5
"""Length of the intervals, s, of which one sample each is used: closer samples are correlated."""
_MOVED = 5e-3, 0.05  # m, rad: least motion of a body between samples that are used


Predicted = tuple[Array, Array]
"""Residuals (M, r) of the samples of a truth stream, and their covariance (M, r, r)."""


@dataclass(frozen=True)
class Score:
    """Log-likelihood of truth given an estimate, or of readings given a robot file.

    Attributes:
        value: Log-likelihood per degree of freedom.
        samples: Degrees of freedom.
        independent: Effective number of independent degrees of freedom, if the errors of all
            streams within an interval are fully correlated.
        constants: Frame, mounts and delays of the truth.
        predicted: Residuals and covariances of truth, by stream; empty for the evidence.
        moments: Indices (M,) of the samples' intervals of APART seconds, by stream; numbers of
            different cases are far apart.
    """

    value: float
    samples: int
    independent: float
    constants: tuple[SensorParameter, ...] = ()
    predicted: tuple[Predicted, ...] = ()
    moments: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Start:
    """Initial guess of an estimate, from an earlier estimate.

    Attributes:
        state: States (K, N) of the nodes, or None for the default initial guess.
        sensor_parameters: Sensor parameters with their values (K, size).
    """

    state: State | None = None
    sensor_parameters: Sequence[tuple[SensorParameter, Array]] = ()

    @staticmethod
    def of(posterior: Posterior) -> Start:
        """Initial guess from a posterior."""
        return Start(posterior.state, posterior.sensor_parameters)


def constants_of(truth: Sequence[Readings]) -> tuple[SensorParameter, ...]:
    """A frame for all truth streams and a mount for each, at the identity."""
    names = tuple(t.name for t in truth)
    made = [("truth frame", "frame", names)]
    made += [(f"{name} mount", "mount", (name,)) for name in names]
    zero = np.zeros(6)
    return tuple(SensorParameter(name, kind, streams, zero, zero) for name, kind, streams in made)


def predict(
    posterior: Posterior,
    truth: Sequence[Readings],
    constants: Sequence[SensorParameter],
    *,
    free: bool,
) -> Score:
    """Score an estimate by the log-likelihood of truth.

    Args:
        posterior: The estimate.
        truth: Truth streams.
        constants: Frame, mounts and delays of the truth streams.
        free: Whether frame and mounts are calibrated first; delays are fixed.
    """
    moving = [c for c in constants if c.moves]
    inside = [corrected(t, moving).inside(posterior.grid) for t in truth]
    sparse = [t for t in informative(inside) if len(t)]
    states = [posterior.at(t.arclength, t.time) for t in sparse]
    constants = tuple(c for c in constants if not c.moves)
    for _ in range(_ROUNDS * free):
        constants = _gauss_newton_step(sparse, states, constants)
    pairs = zip(sparse, states, strict=True)
    predicted = tuple(_residual(corrected(t, constants), at) for t, at in pairs)
    total = sum(_cost(*each) for each in predicted)
    count = sum(residual.size for residual, _ in predicted)
    moments = tuple(t.time // APART for t in sparse)
    intervals = np.concatenate([np.zeros(0), *moments])
    independent = count * np.unique(intervals).size / max(intervals.size, 1)
    value = -total / max(count, 1)
    return Score(value, count, independent, (*constants, *moving), predicted, moments)


def informative(truth: Sequence[Readings]) -> list[Readings]:
    """Select the first samples of those intervals of APART seconds in which the robot has moved.

    Repeated samples of a robot at rest are correlated and would be weighted too much. Motion of any
    stream counts for all, because errors change everywhere, even at a base at rest.

    Args:
        truth: The truth streams of one robot.
    """
    moving = in_motion(truth)
    firsts = [t.select(_starts_interval(t)) for t in truth]
    return [t.select(np.isin(t.time // APART, moving)) for t in firsts]


def in_motion(truth: Sequence[Readings]) -> Array:
    """Indices of the intervals of APART seconds in which any truth stream has moved.

    Args:
        truth: Truth streams; streams other than poses are not compared and always count as moved.
    """
    return np.unique(np.concatenate([np.zeros(0), *(_moved_in(t) for t in truth if len(t))]))


def _starts_interval(truth: Readings) -> NDArray[np.bool_]:
    """Whether each sample (M,) is at the first time of its interval."""
    starts = truth.time[np.diff(truth.time // APART, prepend=-np.inf) > 0.0]
    return np.isin(truth.time, starts)


def _moved_in(truth: Readings) -> Array:
    """Indices of the intervals at whose start a stream has moved since the last one chosen."""
    chosen: list[Readings] = []
    for time in np.unique(truth.time[_starts_interval(truth)]):
        moment = truth.select(truth.time == time)
        if not chosen or _moved_between(chosen[-1], moment):
            chosen.append(moment)
    return np.array([moment.time[0] // APART for moment in chosen])


def _moved_between(before: Readings, after: Readings) -> bool:
    """Whether truth has moved at any arclength; True if the two cannot be compared."""
    poses = after.values.shape[1:] == (4, 4)
    if not poses or not np.array_equal(before.arclength, after.arclength):
        return True
    motion = se3.log(se3.inverse(before.values) @ after.values).reshape(-1, 2, 3)
    return bool(np.any(np.linalg.norm(motion, axis=-1) > _MOVED))


def _cost(residual: Array, cov: Array) -> float:
    """Negative log-likelihood of truth samples."""
    square = np.sum(residual * np.linalg.solve(cov, residual[..., None])[..., 0])
    log_det = np.sum(np.linalg.slogdet(cov)[1])
    return 0.5 * float(square + log_det + residual.size * np.log(2.0 * np.pi))


def _residual(truth: Readings, at: StateEstimate) -> tuple[Array, Array]:
    """Residuals (M, r) of truth samples and their covariances (M, r, r), truth noise included."""
    state = State(at.pose, at.strain, at.velocity)
    jacobian = truth.jacobian(state)
    cov = jacobian @ at.cov @ np.swapaxes(jacobian, -1, -2) + truth.cov
    return truth.residual(state), cov


def _gauss_newton_step(
    truth: Sequence[Readings],
    states: Sequence[StateEstimate],
    constants: tuple[SensorParameter, ...],
) -> tuple[SensorParameter, ...]:
    """Constants after one Gauss–Newton step on the negative log posterior given the truth."""
    size = SIZES["frame"]
    total = size * len(constants)
    information, rhs = np.zeros((total, total)), np.zeros(total)
    for i, constant in enumerate(constants):
        at = slice(i * size, i * size + size)
        weight = np.repeat(_PRIOR_STD[constant.kind], 3) ** -2.0
        information[at, at] += np.diag(weight)
        rhs[at] -= weight * constant.value
    for stream, at_stream in zip(truth, states, strict=True):
        shifted = corrected(stream, constants)
        residual, cov = _residual(shifted, at_stream)
        state = State(at_stream.pose, at_stream.strain, at_stream.velocity)
        own = [i for i, constant in enumerate(constants) if stream.name in constant.streams]
        values = [(constants[i], constants[i].value) for i in own]
        slopes = by_parameters(stream, shifted, state, shifted.jacobian(state), values)
        jacobian = np.zeros((*residual.shape, total))
        for i, slope in zip(own, slopes, strict=True):
            jacobian[..., i * size : (i + 1) * size] = slope
        weighted = np.linalg.solve(cov, jacobian)
        information += np.einsum("mra,mrb->ab", jacobian, weighted)
        rhs -= np.einsum("mra,mr->a", weighted, residual)
    step: Array = np.asarray(np.linalg.solve(information, rhs), dtype=float)
    moved = zip(constants, step.reshape(-1, size), strict=True)
    return tuple(replace(constant, value=constant.value + by) for constant, by in moved)
