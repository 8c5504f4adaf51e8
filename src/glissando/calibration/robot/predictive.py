"""Predictive log-likelihood of truth given an estimate, with the truth's frame and mounts.

The frame of the truth and the mounts of its bodies are seldom known well; they are calibrated as
the constants under which the truth is most likely given the estimate.
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

_PRIOR_STD = {"frame": (0.005, 0.03), "mount": (0.005, 0.05)}  # m, rad: how far off it may be
_ROUNDS = 2  # Gauss-Newton steps towards the constants, from those of the last evaluation
APART = 0.5
"""Seconds between samples that count: closer ones are correlated."""
_MOVED = 5e-3, 0.05  # m, rad: motion of a body between samples that count


Predicted = tuple[Array, Array]
"""Residuals (M, r) of the samples of a truth stream, and their covariance (M, r, r)."""


@dataclass(frozen=True)
class Score:
    """Log-likelihood of truth given an estimate, or of readings given a robot file.

    Attributes:
        value: Log-likelihood per degree of freedom.
        samples: Degrees of freedom.
        independent: Degrees of freedom that are independent; all places of a robot err together.
        constants: Frame, mounts and delays of the truth.
        predicted: The samples of truth, by stream; none of readings.
        moments: The number of the stretch of APART seconds that each sample is of (M,), by stream;
            those of other cases are far apart.
    """

    value: float
    samples: int
    independent: float
    constants: tuple[SensorParameter, ...] = ()
    predicted: tuple[Predicted, ...] = ()
    moments: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Start:
    """Where an estimate starts: what is kept of an earlier one.

    Attributes:
        state: Nodes (K, N).
        sensor_parameters: Sensor parameters with their values (K, size).
    """

    state: State | None = None
    sensor_parameters: Sequence[tuple[SensorParameter, Array]] = ()

    @staticmethod
    def of(posterior: Posterior) -> Start:
        """What is kept of an estimate."""
        return Start(posterior.state, posterior.sensor_parameters)


def constants_of(truth: Sequence[Readings]) -> tuple[SensorParameter, ...]:
    """A frame for all truth streams and a mount for each, expected to be the identity."""
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
        constants: Their frame, mounts and delays.
        free: Whether frame and mounts are calibrated first; delays never are.
    """
    moving = [c for c in constants if c.moves]
    inside = [corrected(t, moving).inside(posterior.grid) for t in truth]
    sparse = [t for t in informative(inside) if len(t)]
    states = [posterior.at(t.arclength, t.time) for t in sparse]
    constants = tuple(c for c in constants if not c.moves)
    for _ in range(_ROUNDS * free):
        constants = _improved(sparse, states, constants)
    pairs = zip(sparse, states, strict=True)
    predicted = tuple(_residual(corrected(t, constants), at) for t, at in pairs)
    total = sum(_cost(*each) for each in predicted)
    count = sum(residual.size for residual, _ in predicted)
    moments = tuple(t.time // APART for t in sparse)
    stretches = np.concatenate([np.zeros(0), *moments])
    independent = count * np.unique(stretches).size / max(stretches.size, 1)
    value = -total / max(count, 1)
    return Score(value, count, independent, (*constants, *moving), predicted, moments)


def informative(truth: Sequence[Readings]) -> list[Readings]:
    """The first moments of those stretches of time in which the robot has moved.

    Repeated samples of a robot at rest are correlated and would count for too much. While it moves,
    errors change everywhere, also at its base, where nothing does.

    Args:
        truth: The truth streams of one robot.
    """
    moving = in_motion(truth)
    firsts = [t.select(_begins_stretch(t)) for t in truth]
    return [t.select(np.isin(t.time // APART, moving)) for t in firsts]


def in_motion(truth: Sequence[Readings]) -> Array:
    """Numbers of the stretches of APART seconds in which a truth stream has moved at any place.

    Args:
        truth: Truth streams; positions cannot be compared and all count as moved.
    """
    return np.unique(np.concatenate([np.zeros(0), *(_moved_in(t) for t in truth if len(t))]))


def _begins_stretch(truth: Readings) -> NDArray[np.bool_]:
    """Whether a sample belongs to the first moment of its stretch (M,)."""
    starts = truth.time[np.diff(truth.time // APART, prepend=-np.inf) > 0.0]
    return np.isin(truth.time, starts)


def _moved_in(truth: Readings) -> Array:
    """Numbers of the stretches at whose first moment a stream has moved since one before."""
    chosen: list[Readings] = []
    for time in np.unique(truth.time[_begins_stretch(truth)]):
        moment = truth.select(truth.time == time)
        if not chosen or _moved_between(chosen[-1], moment):
            chosen.append(moment)
    return np.array([moment.time[0] // APART for moment in chosen])


def _moved_between(before: Readings, after: Readings) -> bool:
    """Whether truth has moved at any place, also where that cannot be compared."""
    poses = after.values.shape[1:] == (4, 4)
    if not poses or not np.array_equal(before.arclength, after.arclength):
        return True
    way = se3.log(se3.inverse(before.values) @ after.values).reshape(-1, 2, 3)
    return bool(np.any(np.linalg.norm(way, axis=-1) > _MOVED))


def _cost(residual: Array, cov: Array) -> float:
    """Minus log-likelihood of truth samples."""
    square = np.sum(residual * np.linalg.solve(cov, residual[..., None])[..., 0])
    log_det = np.sum(np.linalg.slogdet(cov)[1])
    return 0.5 * float(square + log_det + residual.size * np.log(2.0 * np.pi))


def _residual(truth: Readings, at: StateEstimate) -> tuple[Array, Array]:
    """Residual (M, r) of truth samples and its covariance (M, r, r), the truth's own included."""
    state = State(at.pose, at.strain, at.velocity)
    jacobian = truth.jacobian(state)
    cov = jacobian @ at.cov @ np.swapaxes(jacobian, -1, -2) + truth.cov
    return truth.residual(state), cov


def _improved(
    truth: Sequence[Readings],
    states: Sequence[StateEstimate],
    constants: tuple[SensorParameter, ...],
) -> tuple[SensorParameter, ...]:
    """The constants after one Gauss-Newton step towards the most likely truth."""
    size = SIZES["frame"]
    total = size * len(constants)
    information, rhs = np.zeros((total, total)), np.zeros(total)
    for i, constant in enumerate(constants):
        at = slice(i * size, i * size + size)
        weight = np.repeat(_PRIOR_STD[constant.kind], 3) ** -2.0
        information[at, at] += np.diag(weight)
        rhs[at] -= weight * constant.value
    for stream, at_stream in zip(truth, states, strict=True):
        seen = corrected(stream, constants)
        residual, cov = _residual(seen, at_stream)
        state = State(at_stream.pose, at_stream.strain, at_stream.velocity)
        own = [i for i, constant in enumerate(constants) if stream.name in constant.streams]
        values = [(constants[i], constants[i].value) for i in own]
        slopes = by_parameters(stream, seen, state, seen.jacobian(state), values)
        jacobian = np.zeros((*residual.shape, total))
        for i, slope in zip(own, slopes, strict=True):
            jacobian[..., i * size : (i + 1) * size] = slope
        weighted = np.linalg.solve(cov, jacobian)
        information += np.einsum("mra,mrb->ab", jacobian, weighted)
        rhs -= np.einsum("mra,mr->a", weighted, residual)
    step: Array = np.asarray(np.linalg.solve(information, rhs), dtype=float)
    moved = zip(constants, step.reshape(-1, size), strict=True)
    return tuple(replace(constant, value=constant.value + by) for constant, by in moved)
