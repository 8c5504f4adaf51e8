"""What a motion costs: accuracy, time, wear and information, with their partial slopes."""

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

_HAZE = 0.25  # of a zone's radius, over which it fades out


@dataclass(frozen=True)
class Evaluation:
    """What a motion is worth.

    Attributes:
        control: Its control points (C, S+2).
        values: Values (K, C) of the actuators at the moments.
        shapes: The expected shapes.
        known: What is known of the model error.
        row_slopes: Slopes (C, r, q) of the whitened rows of readings by the sensors' places.
        clearances: How far the body is from obstacles.
        slopes: Slopes (O, K, N, 3) of the distances.
        hits: The bound of the risk.
        terms: Cost of each of the objectives, weighted, by name.
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
        """Positions (K, 3) of the tip, m."""
        return self.shapes.place[:, -1]

    @cached_property
    def cov(self) -> Array:
        """Covariances (K, N, 3, 3) of the places, world frame, m²."""
        moves = self.shapes.moves
        return moves @ self.known.off[:, None] @ moves.mT


@dataclass
class Slopes:
    """Partial slopes of a value, gathered before the backward pass.

    Attributes:
        place: By the places (K, N, 3).
        moves: By how they move with the model error (K, N, 3, q).
        off: By the covariance of what the body is off by, as such an error (K, q, q).
        lagged: By the covariance with that a moment later (K−1, q, q).
        before: By that of what is not known of the model error at the corrections (C, q, q).
        control: By the control points (C, S+2).
    """

    place: Array
    moves: Array
    off: Array
    lagged: Array
    before: Array
    control: Array

    @staticmethod
    def zero(at: Evaluation) -> Slopes:
        """No slopes."""
        known, shapes = at.known, at.shapes
        covs = known.off, known.lagged, known.corrections.off
        return Slopes(*map(np.zeros_like, (shapes.place, shapes.moves, *covs, at.control)))


def tip_misses(scene: Scene, space: MotionSpace, at: Evaluation) -> list[tuple[int, Array]]:
    """Moment of each target, and the tip's way from it (3,) over what is allowed."""
    out = []
    for target in scene.targets:
        k = space.moment_at(target.time)
        out.append((k, (at.tip[k] - target.position) / target.tolerance))
    return out


def cost_terms(
    scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None = None
) -> dict[str, float]:
    """The terms of a motion's cost by name, weighted as the scene says.

    Args:
        scene: The scene.
        space: The motions.
        at: The motion.
        slopes: Where their partial slopes are added, if they are asked for.
    """
    return {
        "accuracy": _accuracy(scene, space, at, slopes),
        "time": _time(scene, space, at, slopes),
        "wear": _wear(scene, space, at, slopes),
        "information": sum(_zone(scene, space, at, zone, slopes) for zone in scene.zones),
    }


def _accuracy(scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None) -> float:
    """Variance of the tip at each target, over the square of what is allowed."""
    total = 0.0
    for (k, _), target in zip(tip_misses(scene, space, at), scene.targets, strict=True):
        weight = scene.weights.accuracy / target.tolerance**2
        moves = at.shapes.moves[k, -1]
        spread = moves @ at.known.off[k]
        total += weight * float(np.sum(spread * moves))
        if slopes is not None:
            slopes.moves[k, -1] += 2.0 * weight * spread
            slopes.off[k] += weight * moves.T @ moves
    return total


def _time(scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None) -> float:
    """Mean square distance from the next target at the corrections, over that at the start."""
    ends = np.array([target.time for target in scene.targets])
    positions = np.array([target.position for target in scene.targets])
    late = np.minimum(np.searchsorted(ends, space.moments[space.corrected]), len(ends) - 1)
    away = at.tip[space.corrected] - positions[late]
    first = float(away[0] @ away[0]) + scene.targets[0].tolerance ** 2
    weight = scene.weights.time / (first * len(away))
    if slopes is not None:
        slopes.place[space.corrected, -1] += 2.0 * weight * away
    return weight * float(np.sum(away**2))


def _wear(scene: Scene, space: MotionSpace, at: Evaluation, slopes: Slopes | None) -> float:
    """Mean square speed of all actuators, of their limits."""
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
    """Mean variance of the places in a zone at the corrections, over the robot's radius squared."""
    k = space.corrected
    inside, by_place = _inside(at.shapes, at.shapes.place[k], zone)
    total = float(inside.sum()) + 1e-9
    scale = scene.weights.information * zone.weight / (scene.robot_radius**2 * total)
    moves = at.shapes.moves[k]
    spread = moves @ at.known.corrections.own(at.known.corrections.before)[:, None]
    variance = np.sum(spread * moves, axis=(-2, -1))
    value = scale * float(np.sum(inside * variance))
    if slopes is not None:
        by_inside = scale * variance - value / total
        slopes.place[k] += by_inside[..., None] * by_place
        slopes.moves[k] += 2.0 * (scale * inside)[..., None, None] * spread
        slopes.before += np.einsum("kn,knai,knaj->kij", scale * inside, moves, moves)
    return value


def _inside(shapes: BodyShapes, place: Array, zone: SpaceZone) -> tuple[Array, Array]:
    """How far places (K, N) are in a zone, from 0 to 1, and the slopes (K, N, 3) of that."""
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
    haze = _HAZE * zone.radius
    inside = 0.5 * (1.0 - np.tanh(0.5 * (distance - zone.radius) / haze))
    by_distance = -inside * (1.0 - inside) / haze
    safe = np.maximum(distance, 1e-12)
    return inside, (by_distance / safe)[..., None] * away
