"""The risk of a motion by samples of the model error, drawn jointly over time."""

from __future__ import annotations

import numpy as np

from glissando.geometry.se3 import Array
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem

_SAMPLES = 4000
_NEAR = 5.0  # standard deviations of clearance beyond which nothing is hit
_CURVED = 0.2  # robot radii by which a distance may be less than its linear part says


def sample_risk(
    problem: MotionProblem, at: Evaluation, count: int = _SAMPLES, seed: int = 0,
    moments: int | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Share of sampled model errors with which anything is hit, and its standard deviation.

    The errors are drawn jointly over time. Places are linear in them, distances are not.

    Args:
        problem: The problem.
        at: The motion.
        count: Number of samples.
        seed: Their seed.
        moments: How many of the first moments count; all unless given.
    """
    rng, known, c = np.random.default_rng(seed), at.known, at.clearances
    size, radius = known.before.shape[-1], problem.scene.robot_radius
    error = rng.standard_normal((count, size)) @ _root(known.before[0]).T
    floor = c.floor * rng.standard_normal(count)
    hit = np.zeros(count, dtype=bool)
    near = c.mean < _NEAR * c.std()
    last = len(known.before) if moments is None else moments
    for k in range(last):
        for o, n in np.argwhere(near[:, k]):
            linear = c.mean[o, k, n] + error @ c.by_error[o, k, n] + floor
            maybe = np.flatnonzero(~hit & (linear < _CURVED * radius))
            place = at.shapes.place[k, n] + error[maybe] @ at.shapes.moves[k, n].T
            signed = problem.scene.obstacles[o].distance(place)[0]
            hit[maybe] = signed - radius + floor[maybe] < 0.0
        if k + 1 < last:
            gain = known.kept * known.free[k]
            rest = known.before[k + 1] - gain @ known.before[k] @ gain.T
            error = error @ gain.T + rng.standard_normal((count, size)) @ _root(rest).T
    share = float(hit.mean())
    return share, float(np.sqrt(max(share * (1.0 - share), 1.0 / count) / count))


def _root(cov: Array) -> Array:
    """A root (q, q) of a covariance that may be singular."""
    value, axes = np.linalg.eigh(0.5 * (cov + cov.T))
    return axes * np.sqrt(np.maximum(value, 0.0))
