"""Risk of a motion from samples of the model error, drawn jointly over time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from glissando.geometry.covariance import half_axes
from glissando.geometry.se3 import Array
from glissando.planning.scene.error_belief import KnownError
from glissando.planning.scene.motion_cost import Evaluation
from glissando.planning.scene.motion_problem import MotionProblem
from glissando.planning.scene.risk import Clearances
from glissando.planning.scene.tendon_body import BodyShapes

_SAMPLES = 4000
_NEAR = 5.0  # standard deviations of clearance beyond which hits are neglected
_SPACING, _PLACES = 0.25, 600  # robot radii between two places of the body; places at most
_CURVED = 0.2  # robot radii of linearised clearance below which the exact distance is computed


def sample_risk(
    problem: MotionProblem, at: Evaluation, count: int = _SAMPLES, seed: int = 0,
    moments: int | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Share of sampled model errors that lead to a hit, and its standard deviation.

    The errors are drawn jointly over time. Positions are linear in them, distances are exact. The
    places are so close that the balls about them exceed the body by less than a hundredth of its
    radius; if that takes too many places, larger balls overestimate the risk.

    Args:
        problem: The problem.
        at: The evaluated motion.
        count: Number of samples.
        seed: Seed of the samples.
        moments: Number of the first moments that are checked; all by default.
    """
    problem, shapes, c = at_close_places(problem, at)
    rng = np.random.default_rng(seed)
    floor = c.floor * rng.standard_normal(count)
    hit = np.zeros(count, dtype=bool)
    near = c.mean < _NEAR * c.std()
    errors = _sampled_errors(at.known, count, rng)
    for k, error in zip(
        range(len(at.values) if moments is None else moments), errors, strict=False
    ):
        for o, obstacle in enumerate(problem.scene.obstacles):
            n = np.flatnonzero(near[o, k])
            if not n.size:
                continue
            linear = c.mean[o, k, n] + error @ c.by_error[o, k, n].T + floor[:, None]
            linear[hit] = np.inf
            sample, of = np.nonzero(linear < _CURVED * problem.scene.robot_radius)
            moved = shapes.moves[k, n[of]] @ error[sample, :, None]
            place = shapes.place[k, n[of]] + moved[..., 0]
            signed = obstacle.distance(place)[0]
            hit[sample[signed - problem.radius + floor[sample] < 0.0]] = True
    share = float(hit.mean())
    return share, float(np.sqrt(max(share * (1.0 - share), 1.0 / count) / count))


def at_close_places(
    problem: MotionProblem, at: Evaluation
) -> tuple[MotionProblem, BodyShapes, Clearances]:
    """Problem, shapes and clearances of a motion at places close enough to represent the body."""
    length = float(problem.body.arclength[-1])
    return problem.cut(at, max(_SPACING * problem.scene.robot_radius, length / _PLACES))


def _sampled_errors(known: KnownError, count: int, rng: np.random.Generator) -> Iterator[Array]:
    """Samples (count, q) of the body's deviation, as a model error, moment by moment.

    An update by readings changes the estimate by minus the change of the estimation error.
    """
    at, (correction, share) = known.corrections, known.shares
    error = rng.standard_normal((count, at.before.shape[-1])) @ half_axes(at.before[0]).T
    estimate, noise_std = np.zeros_like(error), np.sqrt(1.0 - at.fade**2)
    size = len(at.left)
    off = error[:, :size]
    for k in range(len(at.before) - 1):
        noise_cov = at.after[k] - at.free[k] @ at.before[k] @ at.free[k].T
        updated = error @ at.free[k].T + rng.standard_normal(error.shape) @ half_axes(noise_cov).T
        estimate = at.fade * (estimate + error - updated)
        error = at.fade * updated + noise_std * rng.standard_normal(error.shape)
        later = error[:, :size] + estimate[:, :size] @ at.left.T
        bridge, before = np.zeros_like(off), 0.0
        for part in share[correction == k]:
            cross, variance = at.bridge(np.array([before, part]), np.array([part, part]))
            of_before = float(at.bridge(np.array(before), np.array(before)))
            keep = cross / of_before if of_before else 0.0
            step_std = np.sqrt(max(variance - keep * cross, 0.0))
            bridge = keep * bridge + step_std * rng.standard_normal(off.shape)
            before = float(part)
            yield (1.0 - part) * off + part * later + bridge
        off = later
