"""Joint planning problem of robot and sensors: cost and risk of a motion, with gradients.

A motion consists of the paths of all tendons and slides, quadratic B-splines within their limits.
The tendons determine the shapes, shapes and slides the covariance of the model error, and both the
risk. One backward pass propagates all gradients to the control points.
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

_ROUNDING = 1e-9  # share of a step


@dataclass(frozen=True)
class MotionProblem:
    """Planning problem: a scene, a body, and the belief about its model error.

    Attributes:
        scene: The scene.
        body: The body.
        belief: Belief about model error and sensor errors at the start.
        space: Space of admissible motions.
        senses: Whether future readings are taken into account.
        sensed: Uncertain parameters of the sensors.
    """

    scene: Scene
    body: TendonBody
    belief: ErrorBelief
    space: MotionSpace
    senses: bool = True
    sensed: SensorErrors = field(default_factory=SensorErrors)

    @cached_property
    def time_scale(self) -> Array:
        """Correlation times (n,) of the components of the belief, s."""
        own = np.full(self.body.errors, self.body.time_scale)
        return np.concatenate([own, self.sensed.time_scale])

    def expected(self, time: float | Array) -> Array:
        """Expected model errors (…, q) at times (…), s."""
        fade = np.exp(-np.asarray(time)[..., None] / self.body.time_scale)
        return np.asarray(fade * self.belief.mean[: self.body.errors])

    @cached_property
    def radius(self) -> float:
        """Radius of balls about the places that together contain a straight body, m."""
        return float(np.hypot(self.scene.robot_radius, 0.5 * self.body.step.max()))

    @property
    def wider(self) -> float:
        """Excess of that radius over the robot's, m, by which clearances are underestimated."""
        return self.radius - self.scene.robot_radius

    def evaluate(self, control: Array, like: Evaluation | None = None) -> Evaluation:
        """Evaluate shapes, uncertainty, risk and cost of a motion.

        Args:
            control: Control points (C, S+2) of the motion.
            like: A similar motion, whose shapes are initial values of the equilibria.

        Raises:
            NoShapeError: No equilibrium was found.
        """
        values = self.space.basis @ control.T
        start = None if like is None else like.shapes.balance.strain
        error, pulled = self.expected(self.space.moments), values[:, : len(self.scene.tendons)]
        shapes = self.body.shapes(pulled, error, start)
        rows, row_slopes = self._rows(shapes, values)
        fade = np.exp(-self.space.correction / self.time_scale)
        known = predict_covariance(self.belief.cov, rows, fade, self.body.left)
        deviation = KnownError(known, self.space.position)
        clearances, slopes = self._clearances(shapes, deviation)
        hits = bound_hits(clearances)
        out = Evaluation(
            control, values, shapes, deviation, row_slopes, clearances, slopes, hits, {}
        )
        return replace(out, terms=cost_terms(self.scene, self.space, out))

    def cut(self, at: Evaluation, spacing: float) -> tuple[MotionProblem, BodyShapes, Clearances]:
        """Problem, shapes and clearances of a motion with places at most `spacing` m apart.

        The covariances of the model error are those of the unrefined motion.
        """
        more = max(1, int(np.ceil(self.body.step.max() / spacing - _ROUNDING)))
        finer = replace(self, body=replace(self.body, steps=more * self.body.steps))
        shapes = BodyShapes(finer.body, at.shapes.balance, at.shapes.base)
        return finer, shapes, finer._clearances(shapes, at.known)[0]

    def log_risk(self, at: Evaluation) -> float:
        """Logarithm of the risk bound, plus the depth of the expected body in obstacles.

        The depth, a sum of squares in robot radii, is zero where the risk is small. Where a hit is
        certain the gradient of the risk vanishes, but that of the depth does not.
        """
        deep = np.minimum(at.clearances.mean, 0.0) / self.scene.robot_radius
        return float(np.log(max(at.hits.value, 1e-30)) + np.sum(deep**2))

    def gradients(self, at: Evaluation) -> tuple[Array, Array]:
        """Gradients (n,) of cost and `log_risk` by the free variables, in one backward pass."""
        slopes = Slopes.zero(at)
        cost_terms(self.scene, self.space, at, slopes)
        cost, risk = self._back(at, [slopes, self._log_risk_slopes(at)])
        return cost, risk

    def _log_risk_slopes(self, at: Evaluation) -> Slopes:
        """Partial gradients of `log_risk`."""
        slopes, share = Slopes.zero(at), 1.0 / max(at.hits.value, 1e-30)
        slopes.off += share * at.hits.by_cov
        slopes.lagged += share * at.hits.by_lagged
        self._add_hits(at, share, slopes)
        deep = np.minimum(at.clearances.mean, 0.0) / self.scene.robot_radius**2
        slopes.place += 2.0 * np.einsum("okn,okni->kni", deep, at.slopes)
        return slopes

    def misses(self, at: Evaluation) -> Array:
        """Squared distances (G,) of the tip from each target at its time, in squared tolerances."""
        return np.array([float(away @ away) for _, away in tip_misses(self.scene, self.space, at)])

    def misses_gradient(self, at: Evaluation) -> Array:
        """Jacobian (G, n) of `misses` by the free variables."""
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
        """Gradients (n,) by the free variables, of values whose partial gradients are given."""
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
        """Clearances of all places, and gradients (O, K, N, 3) of the distances."""
        lead = shapes.place.shape[:2]
        parts = distances(self.scene.obstacles, shapes.place.reshape(-1, 3))
        signed, slope = (part.reshape(len(part), *lead, *part.shape[2:]) for part in parts)
        by_error = (slope[..., None, :] @ shapes.moves)[..., 0, :]
        mean = signed - self.radius
        floor = self.scene.model_std
        return Clearances(mean, by_error, known.off, known.lagged, floor), slope

    def _add_hits(self, at: Evaluation, weight: float, slopes: Slopes) -> None:
        """Add gradients of the risk by positions and by their Jacobian with the model error."""
        events = np.nonzero(at.hits.by_mean)
        by_mean, by_error = weight * at.hits.by_mean[events], weight * at.hits.by_error[events]
        normal, place_indices = at.slopes[events], events[1:]
        moved = (at.shapes.moves[place_indices] @ by_error[..., None])[..., 0]
        place, by_turn = at.shapes.place[place_indices], np.empty_like(moved)
        for o, obstacle in enumerate(self.scene.obstacles):
            own = events[0] == o
            by_turn[own] = (obstacle.curvature(place[own]) @ moved[own, :, None])[..., 0]
        np.add.at(slopes.place, place_indices, by_mean[:, None] * normal + by_turn)
        np.add.at(slopes.moves, place_indices, normal[:, :, None] * by_error[:, None, :])

    def _rows(self, shapes: BodyShapes, values: Array) -> tuple[Array, Array]:
        """Whitened rows (M, r, n) of the readings at each correction, and derivatives by arclength.

        The derivatives (M, r, q) are those of the rows' columns for the model error.
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
        """Gradients by twists, and (G, K, L) by slides, from those (G, M, r, n) by the rows."""
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
        """Whitened rows of each sensor for all readings of an interval; see `SensorErrors.rows`."""
        time = self.space.correction
        return [self.sensed.rows(sensor, time) for sensor in self.scene.sensors]

    def neighbours(self, arclength: Array) -> tuple[Index, Array]:
        """Indices (M, 4) of places about arclengths (M,); cubic weights and slopes (M, 2, 4)."""
        nodes = self.body.arclength
        last = nodes.size - 2
        lower = np.clip(np.searchsorted(nodes, arclength, side="right") - 1, 0, last)
        width = nodes[lower + 1] - nodes[lower]
        weights = cubic_weights((arclength - nodes[lower]) / width)
        weights[:, 1] /= width[:, None]
        return np.clip(lower[:, None] + np.arange(-1, 3), 0, nodes.size - 1), weights
