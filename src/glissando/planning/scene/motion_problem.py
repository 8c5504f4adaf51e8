"""One problem for robot and sensors: the cost and the risk of a motion, with their slopes.

A motion is the paths of all tendons and slides, quadratic B-splines within the limits of each. Its
shapes follow from the tendons, what is known from the shapes and the slides, the risk from both;
one backward pass takes all slopes back to the control points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.planning.path_objective import cubic_weights
from glissando.planning.scene.error_belief import (
    ErrorBelief,
    KnownError,
    predict_covariance,
)
from glissando.planning.scene.motion_cost import Evaluation, Slopes, cost_terms, tip_misses
from glissando.planning.scene.motion_space import MotionSpace
from glissando.planning.scene.obstacles import distances
from glissando.planning.scene.risk import Clearances, bound_hits
from glissando.planning.scene.scene import Scene
from glissando.planning.scene.sensor_errors import SensorErrors
from glissando.planning.scene.tendon_body import BodyShapes, BySeen, TendonBody

_ROUNDING = 1e-9  # of a step


@dataclass(frozen=True)
class MotionProblem:
    """A scene and a body with a belief about its model error: what a motion is judged by.

    Attributes:
        scene: The scene.
        body: The body.
        belief: What is known of the model error at the start, and of the sensors' errors.
        space: The motions.
        senses: Whether readings to come are counted on.
        sensed: What is unknown of the sensors.
    """

    scene: Scene
    body: TendonBody
    belief: ErrorBelief
    space: MotionSpace
    senses: bool = True
    sensed: SensorErrors = field(default_factory=SensorErrors)

    @cached_property
    def time_scale(self) -> Array:
        """How long each number of the belief lasts (n,), s."""
        own = np.full(self.body.errors, self.body.time_scale)
        return np.concatenate([own, self.sensed.time_scale])

    def expected(self, time: float | Array) -> Array:
        """Model errors (…, q) that are expected at times (…), s."""
        fade = np.exp(-np.asarray(time)[..., None] / self.body.time_scale)
        return np.asarray(fade * self.belief.mean[: self.body.errors])

    @cached_property
    def radius(self) -> float:
        """Radius of balls about the places that hold all of a straight body between them, m."""
        return float(np.hypot(self.scene.robot_radius, 0.5 * self.body.step.max()))

    @property
    def wider(self) -> float:
        """By how much those balls are wider than the robot, m: clearances are so much more."""
        return self.radius - self.scene.robot_radius

    def evaluate(self, control: Array, like: Evaluation | None = None) -> Evaluation:
        """What a motion with control points (C, S+2) is worth.

        Args:
            control: The control points.
            like: A similar motion, from whose shapes the search for these begins.

        Raises:
            NoShapeError: A shape was not found.
        """
        values = self.space.basis @ control.T
        start = None if like is None else like.shapes.balance.strain
        error, pulled = self.expected(self.space.moments), values[:, : len(self.scene.tendons)]
        shapes = self.body.shapes(pulled, error, start)
        rows, row_slopes = self._rows(shapes, values)
        fade = np.exp(-self.space.correction / self.time_scale)
        known = predict_covariance(self.belief.cov, rows, fade, self.body.left)
        left = KnownError(known, self.space.position)
        clearances, slopes = self._clearances(shapes, left)
        hits = bound_hits(clearances)
        out = Evaluation(control, values, shapes, left, row_slopes, clearances, slopes, hits, {})
        return replace(out, terms=cost_terms(self.scene, self.space, out))

    def cut(self, at: Evaluation, spacing: float) -> tuple[MotionProblem, BodyShapes, Clearances]:
        """The problem, and a motion's shapes and clearances, with places closer than a spacing, m.

        What is known of the model error stays as it is.
        """
        more = max(1, int(np.ceil(self.body.step.max() / spacing - _ROUNDING)))
        finer = replace(self, body=replace(self.body, steps=more * self.body.steps))
        shapes = BodyShapes(finer.body, at.shapes.balance, at.shapes.base)
        return finer, shapes, finer._clearances(shapes, at.known)[0]

    def log_risk(self, at: Evaluation) -> float:
        """Logarithm of the bound of the risk, plus how deep the expected body is in obstacles.

        The depth, a sum of squares in robot radii, is zero where the risk is small; where a hit is
        certain it has a slope, and the risk has none.
        """
        deep = np.minimum(at.clearances.mean, 0.0) / self.scene.robot_radius
        return float(np.log(max(at.hits.value, 1e-30)) + np.sum(deep**2))

    def gradients(self, at: Evaluation) -> tuple[Array, Array]:
        """Slopes (n,) of the cost and of `log_risk` by the free numbers, in one backward pass."""
        slopes = Slopes.zero(at)
        cost_terms(self.scene, self.space, at, slopes)
        cost, risk = self._back(at, [slopes, self._log_risk_slopes(at)])
        return cost, risk

    def _log_risk_slopes(self, at: Evaluation) -> Slopes:
        """Partial slopes of `log_risk`."""
        slopes, share = Slopes.zero(at), 1.0 / max(at.hits.value, 1e-30)
        slopes.off += share * at.hits.by_cov
        slopes.lagged += share * at.hits.by_lagged
        self._add_hits(at, share, slopes)
        deep = np.minimum(at.clearances.mean, 0.0) / self.scene.robot_radius**2
        slopes.place += 2.0 * np.einsum("okn,okni->kni", deep, at.slopes)
        return slopes

    def misses(self, at: Evaluation) -> Array:
        """How far the tip is from each target (G,) at its time, over what is allowed, squared."""
        return np.array([float(away @ away) for _, away in tip_misses(self.scene, self.space, at)])

    def misses_gradient(self, at: Evaluation) -> Array:
        """Slopes (G, n) of `misses` by the free numbers."""
        tip, rows = at.shapes.tip_by_displacement(), []
        for (k, away), target in zip(
            tip_misses(self.scene, self.space, at), self.scene.targets, strict=True
        ):
            by_value = np.zeros_like(at.values)
            by_tip = 2.0 * away / target.tolerance
            by_value[k, : tip.shape[-1]] = by_tip @ tip[k]
            rows.append(self.space.free_gradient(by_value, np.zeros_like(at.control)))
        return np.stack(rows)

    def _back(self, at: Evaluation, slopes: Sequence[Slopes]) -> list[Array]:
        """Slopes (n,) by the free numbers, of values whose partial slopes are given."""
        by_rows = np.stack([at.known.back(one.off, one.lagged, one.before) for one in slopes])
        by_twist, by_slides = self._back_rows(at, by_rows)
        by_place, by_moves = (np.stack([getattr(one, name) for one in slopes])
                              for name in ("place", "moves"))  # fmt: skip
        by_tendons = at.shapes.back(by_place, by_moves, by_twist)
        by_value = np.concatenate([by_tendons, by_slides], axis=-1)
        return [
            self.space.free_gradient(by, one.control)
            for by, one in zip(by_value, slopes, strict=True)
        ]

    def _clearances(self, shapes: BodyShapes, known: KnownError) -> tuple[Clearances, Array]:
        """Clearances of all places, and slopes (O, K, N, 3) of the distances."""
        lead = shapes.place.shape[:2]
        parts = distances(self.scene.obstacles, shapes.place.reshape(-1, 3))
        signed, slope = (part.reshape(len(part), *lead, *part.shape[2:]) for part in parts)
        by_error = (slope[..., None, :] @ shapes.moves)[..., 0, :]
        mean = signed - self.radius
        floor = self.scene.model_std
        return Clearances(mean, by_error, known.off, known.lagged, floor), slope

    def _add_hits(self, at: Evaluation, weight: float, slopes: Slopes) -> None:
        """Add slopes of the risk by places and by how they move with the model error."""
        events = np.nonzero(at.hits.by_mean)
        by_mean, by_error = weight * at.hits.by_mean[events], weight * at.hits.by_error[events]
        normal, here = at.slopes[events], events[1:]
        moved = (at.shapes.moves[here] @ by_error[..., None])[..., 0]
        place, turned = at.shapes.place[here], np.empty_like(moved)
        for o, obstacle in enumerate(self.scene.obstacles):
            own = events[0] == o
            turned[own] = (obstacle.curvature(place[own]) @ moved[own, :, None])[..., 0]
        np.add.at(slopes.place, here, by_mean[:, None] * normal + turned)
        np.add.at(slopes.moves, here, normal[:, :, None] * by_error[:, None, :])

    def _rows(self, shapes: BodyShapes, values: Array) -> tuple[Array, Array]:
        """Whitened rows (C, r, n) of the readings of each correction, and their slopes by place.

        The slopes (C, r, q) are of what the rows say of the model error.
        """
        values = values[self.space.corrected]
        rows = [np.zeros((len(values), 0, self.time_scale.size))]
        slopes = [np.zeros((len(values), 0, self.body.errors))]
        first = len(self.scene.tendons)
        for c, sensor in enumerate(self.scene.sensors if self.senses else ()):
            own, repeated = self._white[c]
            repeated = np.broadcast_to(repeated, (len(values), *repeated.shape))
            for behind in sensor.behind:
                at, weights = self.neighbours(values[:, first + c] - behind)
                near = shapes.body_twist_at(self.space.corrected[:, None], at)
                both = (weights @ near.reshape(*near.shape[:2], -1)).reshape(
                    len(near), 2, *near.shape[2:]
                )
                rows.append(np.concatenate([own @ both[:, 0], repeated], axis=-1))
                slopes.append(own @ both[:, 1])
        return np.concatenate(rows, axis=1), np.concatenate(slopes, axis=1)

    def _back_rows(self, at: Evaluation, by_rows: Array) -> tuple[list[BySeen], Array]:
        """Slopes by twists and (G, K, L) by slides, of those (G, C, r, q) by the rows."""
        by_twist: list[BySeen] = []
        first, corrected = len(self.scene.tendons), self.space.corrected
        by_rows = by_rows[..., : self.body.errors]
        by_slides = np.zeros((len(by_rows), len(at.values), at.values.shape[1] - first))
        row = 0
        for c, sensor in enumerate(self.scene.sensors if self.senses else ()):
            own = self._white[c][0]
            for behind in sensor.behind:
                part, slope = (x[..., row : row + len(own), :] for x in (by_rows, at.row_slopes))
                by_slides[:, corrected, c] += np.sum(part * slope, axis=(-2, -1))
                near, weights = self.neighbours(at.values[corrected, first + c] - behind)
                back = weights[:, 0, :, None, None] * (own.T @ part)[:, :, None]
                by_twist.append((corrected[:, None], near, back))
                row += len(own)
        return by_twist, by_slides

    @cached_property
    def _white(self) -> list[tuple[Array, Array]]:
        """Whitened rows of each sensor, worth its readings of a correction: `SensorErrors.rows`."""
        time = self.space.correction
        return [self.sensed.rows(sensor, time) for sensor in self.scene.sensors]

    def neighbours(self, arclength: Array) -> tuple[Index, Array]:
        """Four places (M, 4) about arclengths (M,), and their weights and slopes (M, 2, 4)."""
        nodes = self.body.arclength
        last = nodes.size - 2
        lower = np.clip(np.searchsorted(nodes, arclength, side="right") - 1, 0, last)
        width = nodes[lower + 1] - nodes[lower]
        weights = cubic_weights((arclength - nodes[lower]) / width)
        weights[:, 1] /= width[:, None]
        return np.clip(lower[:, None] + np.arange(-1, 3), 0, nodes.size - 1), weights
