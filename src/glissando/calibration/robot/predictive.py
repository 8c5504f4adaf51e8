"""How well an estimate foretells truth: its predictive log-likelihood, frames and mounts put right.

Truth is seldom where one thinks: its frame and the mounts of its bodies are calibrated, as the
constants under which the truth is most likely given the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from glissando.estimation.posterior import Posterior, StateEstimate
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.sensors.parameters import SIZES, SensorParameter, corrected
from glissando.model.sensors.readings import Readings
from glissando.model.state import State

_LOOSE = {"frame": (0.005, 0.03), "mount": (0.005, 0.05)}  # m, rad: how far off it may be
_ROUNDS = 2  # Gauss-Newton steps towards the constants; they begin where the last try ended
_NUDGE = 1e-6
APART = 0.5
"""Seconds between samples that are judged: closer ones are much alike."""
_MOVED = 5e-3, 0.05  # m, rad: by which a body moves between them, for the same reason


@dataclass(frozen=True)
class Prediction:
    """Log-likelihood of the truth, per sample and degree of freedom, and the constants found.

    Of `samples` degrees of freedom so many are `independent`: all places of a robot err together.
    """

    score: float
    samples: int
    independent: float
    constants: tuple[SensorParameter, ...]


def constants_of(truth: Sequence[Readings]) -> tuple[SensorParameter, ...]:
    """One frame for all truth streams and a mount for each, expected to be nothing."""
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
) -> Prediction:
    """Judge a posterior by truth streams; with `free` the constants are calibrated, else held.

    Those that move readings, as a delay does, are always held.
    """
    moving = [c for c in constants if c.moves]
    there = [corrected(t, moving).inside(posterior.grid) for t in truth]
    sparse = [telling(t) for t in there if len(t)]
    found = [posterior.at(t.arclength, t.time) for t in sparse]
    constants = tuple(c for c in constants if not c.moves)
    for _ in range(_ROUNDS * free):
        constants = _improved(sparse, found, constants)
    terms = [_normalised(t, at, constants) for t, at in zip(sparse, found, strict=True)]
    total = sum(float(np.sum(cost)) for cost, _ in terms)
    count = sum(size for _, size in terms)
    stretches = np.concatenate([np.zeros(0), *(t.time // APART for t in sparse)])
    independent = count * np.unique(stretches).size / max(stretches.size, 1)
    return Prediction(-total / max(count, 1), count, independent, (*constants, *moving))


def telling(truth: Readings) -> Readings:
    """The first moment of each stretch of time, if truth has moved since the last that was taken.

    What rests says the same again: samples of it would count for more than they tell.
    """
    stretch = np.floor(truth.time / APART)
    begins = truth.time[np.append(True, np.diff(stretch) > 0.0)]
    taken: list[Readings] = []
    for moment in (truth.select(truth.time == begin) for begin in begins):
        if not taken or _moved_between(taken[-1], moment):
            taken.append(moment)
    return truth.select(np.isin(truth.time, [float(moment.time[0]) for moment in taken]))


def _moved_between(before: Readings, after: Readings) -> bool:
    """Whether truth is elsewhere than before, at any place; also if that cannot be compared."""
    poses = after.values.shape[1:] == (4, 4)
    if not poses or not np.array_equal(before.arclength, after.arclength):
        return True
    way = se3.log(se3.inverse(before.values) @ after.values).reshape(-1, 2, 3)
    return bool(np.any(np.linalg.norm(way, axis=-1) > _MOVED))


def _normalised(
    truth: Readings, at: StateEstimate, constants: Sequence[SensorParameter]
) -> tuple[Array, int]:
    """Minus log-likelihood (M,) of truth samples, and their degrees of freedom altogether."""
    residual, cov = _miss(corrected(truth, constants), at)
    solved = np.linalg.solve(cov, residual[..., None])[..., 0]
    size = residual.shape[1]
    square = np.sum(residual * solved, axis=1)
    cost: Array = 0.5 * (square + np.linalg.slogdet(cov)[1] + size * np.log(2.0 * np.pi))
    return cost, residual.size


def _miss(truth: Readings, at: StateEstimate) -> tuple[Array, Array]:
    """Residual (M, r) of truth samples and its covariance (M, r, r), the truth's own included."""
    state = State(at.pose, at.strain, at.velocity)
    jacobian = truth.jacobian(state)
    cov = jacobian @ at.cov @ np.swapaxes(jacobian, -1, -2) + truth.cov
    return truth.residual(state), cov


def _improved(
    truth: Sequence[Readings],
    found: Sequence[StateEstimate],
    constants: tuple[SensorParameter, ...],
) -> tuple[SensorParameter, ...]:
    """The constants after one Gauss-Newton step towards the most likely truth."""
    size = SIZES["frame"]
    total = size * len(constants)
    information, pull = np.zeros((total, total)), np.zeros(total)
    for i, constant in enumerate(constants):
        at = slice(i * size, i * size + size)
        weight = np.repeat(_LOOSE[constant.kind], 3) ** -2.0
        information[at, at] += np.diag(weight)
        pull[at] -= weight * constant.value
    for stream, there in zip(truth, found, strict=True):
        residual, cov = _miss(corrected(stream, constants), there)
        state = State(there.pose, there.strain, there.velocity)
        jacobian = np.zeros((*residual.shape, total))
        for i, constant in enumerate(constants):
            if stream.name in constant.streams:
                for j, nudge in enumerate(_NUDGE * np.eye(size)):
                    ends = [
                        corrected(stream, _moved(constants, i, sign * nudge)).residual(state)
                        for sign in (1.0, -1.0)
                    ]
                    jacobian[..., i * size + j] = (ends[0] - ends[1]) / (2.0 * _NUDGE)
        weighed = np.linalg.solve(cov, jacobian)
        information += np.einsum("mra,mrb->ab", jacobian, weighed)
        pull -= np.einsum("mra,mr->a", weighed, residual)
    step: Array = np.asarray(np.linalg.solve(information, pull), dtype=float)
    for i in range(len(constants)):
        constants = _moved(constants, i, step[i * size : i * size + size])
    return constants


def _moved(
    constants: tuple[SensorParameter, ...], i: int, step: Array
) -> tuple[SensorParameter, ...]:
    there = list(constants)
    there[i] = replace(there[i], value=there[i].value + step)
    return tuple(there)
