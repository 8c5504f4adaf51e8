"""Cost of a motion: accuracy, time, wear and information, with partial gradients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.planning.scene.error_belief import KnownError
from glissando.planning.scene.motion_space import MotionSpace
from glissando.planning.scene.risk import Clearances, HitBound
from glissando.planning.scene.scene import Scene, SpaceZone
from glissando.planning.scene.tendon_body import BodyShapes

_BLUR = 0.25  # width of a zone's smooth boundary over its radius


@dataclass(frozen=True)
class Evaluation:
    """A motion with its shapes, uncertainty, risk and cost.

    Attributes:
        control: Control points (C, S+2) of the C actuators, m.
        values: Values (K, C) of the actuators at the moments, m.
        shapes: Expected shapes at the moments.
        known: Covariances of the body's deviation, as a model error.
        row_slopes: Derivatives (M, r, q) of the readings' whitened rows at each correction by the
            sensors' arclengths.
        clearances: Distances of the body from obstacles.
        slopes: Gradients (O, K, N, 3) of the distances by position.
        hits: Bound of the collision probability.
        terms: Weighted cost terms by name.
    """

    control: Array
    values: Array
    shapes: BodyShapes
    known: KnownError
    row_slopes: Array
    clearances: Clearances
    slopes: Array
    hits: HitBound
    terms: dict[str, float]

    @property
    def cost(self) -> float:
        """Sum of the terms."""
        return sum(self.terms.values())

    @property
    def tip(self) -> Array:
        """Expected positions (K, 3) of the tip, world frame, m."""
        return self.shapes.place[:, -1]

    @cached_property
    def cov(self) -> Array:
        """Covariances (K, N, 3, 3) of the positions, world frame, m²."""
        moves = self.shapes.moves
        return moves @ self.known.off[:, None] @ moves.mT


@dataclass
class Slopes:
    """Partial gradients of a value, accumulated before the backward pass.

    Attributes:
        place: Gradient (K, N, 3) by the positions.
        moves: Gradient (K, N, 3, q) by the positions' Jacobian with respect to the model error.
        off: Gradient (K, q, q) by the covariance of the body's deviation, as a model error.
        lagged: Gradient (K−1, q, q) by its covariance with the deviation at the next moment.
        before: Gradient (M, q, q) by the covariance of the model error at the M corrections.
        control: Gradient (C, S+2) by the control points.
    """

    place: Array
    moves: Array
    off: Array
    lagged: Array
    before: Array
    control: Array

    @staticmethod
    def zero(at: Evaluation) -> Slopes:
        """Gradients that are zero, in the shapes of an evaluation."""
        known, shapes = at.known, at.shapes
        covs = known.off, known.lagged, known.corrections.off
        return Slopes(*map(np.zeros_like, (shapes.place, shapes.moves, *covs, at.control)))


def tip_misses(scene: Scene, space: MotionSpace, at: Evaluation) -> list[tuple[int, Array]]:
    """Moment index of each target, and offset (3,) of the tip from it over the tolerance."""
    out = []
    for target in scene.targets:
        k = space.moment_at(target.time)
        out.append((k, (at.tip[k] - target.position) / target.tolerance))
    return out


def cost_terms(
    scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None = None
) -> dict[str, float]:
    """Terms of a motion's cost by name, with the scene's weights.

    Args:
        scene: The scene.
        space: Space of the motion.
        at: The evaluated motion.
        slopes: Accumulates the partial gradients of the cost; None to skip them.
    """
    return {
        "accuracy": _accuracy(scene, space, at, slopes),
        "time": _time(scene, space, at, slopes),
        "wear": _wear(scene, space, at, slopes),
        "information": sum(_zone(scene, space, at, zone, slopes) for zone in scene.zones),
    }


def _accuracy(scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None) -> float:
    """Total variance of the tip at each target over the squared tolerance, summed over targets."""
    total = 0.0
    for (k, _), target in zip(tip_misses(scene, space, at), scene.targets, strict=True):
        weight = scene.weights.accuracy / target.tolerance**2
        moves = at.shapes.moves[k, -1]
        moves_cov = moves @ at.known.off[k]
        total += weight * float(np.sum(moves_cov * moves))
        if slopes is not None:
            slopes.moves[k, -1] += 2.0 * weight * moves_cov
            slopes.off[k] += weight * moves.T @ moves
    return total


def _time(scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None) -> float:
    """Mean square distance from the next target at the corrections, over that at the start."""
    ends = np.array([target.time for target in scene.targets])
    positions = np.array([target.position for target in scene.targets])
    upcoming = np.minimum(np.searchsorted(ends, space.moments[space.corrected]), len(ends) - 1)
    offset = at.tip[space.corrected] - positions[upcoming]
    initial = float(offset[0] @ offset[0]) + scene.targets[0].tolerance ** 2
    weight = scene.weights.time / (initial * len(offset))
    if slopes is not None:
        slopes.place[space.corrected, -1] += 2.0 * weight * offset
    return weight * float(np.sum(offset**2))


def _wear(scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None) -> float:
    """Mean square speed of all actuators over their limits."""
    limit = np.array([path.speed * path.step for path in space.paths])[:, None]
    speed = np.diff(at.control, axis=1) / limit
    weight = scene.weights.wear / speed.size
    if slopes is not None:
        by_speed = 2.0 * weight * speed / limit
        slopes.control[:, 1:] += by_speed
        slopes.control[:, :-1] -= by_speed
    return weight * float(np.sum(speed**2))


def _zone(
    scene: Scene, space: MotionSpace, at: Evaluation, zone: SpaceZone, slopes: Slopes | None
) -> float:
    """Mean variance of positions in a zone at the corrections, over the robot's radius squared."""
    k = space.corrected
    inside, by_place = _inside(at.shapes, at.shapes.place[k], zone)
    total = float(inside.sum()) + 1e-9
    scale = scene.weights.information * zone.weight / (scene.robot_radius**2 * total)
    moves = at.shapes.moves[k]
    moves_cov = moves @ at.known.corrections.own(at.known.corrections.before)[:, None]
    variance = np.sum(moves_cov * moves, axis=(-2, -1))
    value = scale * float(np.sum(inside * variance))
    if slopes is not None:
        by_inside = scale * variance - value / total
        slopes.place[k] += by_inside[..., None] * by_place
        slopes.moves[k] += 2.0 * (scale * inside)[..., None, None] * moves_cov
        slopes.before += np.einsum("kn,knai,knaj->kij", scale * inside, moves, moves)
    return value


def _inside(shapes: BodyShapes, place: Array, zone: SpaceZone) -> tuple[Array, Array]:
    """Smooth membership (K, N) in [0, 1] of positions in a zone, and its gradients (K, N, 3)."""
    if zone.arclength is not None:
        low, high = zone.arclength
        s = shapes.body.arclength
        near = (s >= low - 0.5 * shapes.body.step.max()) & (
            s <= high + 0.5 * shapes.body.step.max()
        )
        return np.broadcast_to(near.astype(float), place.shape[:2]), np.zeros(place.shape)
    assert zone.center is not None
    away = place - zone.center
    distance = np.linalg.norm(away, axis=-1)
    blur = _BLUR * zone.radius
    inside = 0.5 * (1.0 - np.tanh(0.5 * (distance - zone.radius) / blur))
    by_distance = -inside * (1.0 - inside) / blur
    safe = np.maximum(distance, 1e-12)
    return inside, (by_distance / safe)[..., None] * away
