"""Shapes of a robot fitted to tracked poses at single moments, independently of its prior.

The guard must not rely on the values that it checks: shapes follow a generic random walk of
curvature instead of a robot file's densities, and readings have large generic standard deviations.
Many moments are fitted as one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Grid
from glissando.model.robot import Robot

_KNOTS, _PIECES = 9, 12  # knots of strain along the robot, integration steps
ROUNDS, _STAGES = 18, 6  # iterations, in stages that include more and more of the robot
_AHEAD = 0.1  # factor on the weight of readings beyond the included part
_POSITION, _AXIS = 0.02, 0.12  # std of readings, over the length and in rad; above model errors
_BASE = np.repeat([0.01, 0.05], 3)  # std of the base, over the length and in rad
_AXES = np.stack([se3.hat3(-axis) for axis in np.eye(3)])  # derivatives of body axes by rotation


@dataclass(frozen=True)
class TrackedPoses:
    """Tracked poses of J streams at B moments.

    Attributes:
        place: Arclengths (B, J), m.
        pose: Poses (B, J, 4, 4) in the world.
        weight: Weights (B, J, 4) of the position and of each body axis; 0 if not measured.
    """

    place: Array
    pose: Array
    weight: Array

    def without(self, streams: list[int]) -> TrackedPoses:
        """Copy in which the weights of some streams are zero."""
        weight = self.weight.copy()
        weight[:, streams] = 0.0
        return replace(self, weight=weight)

    def joined(self, others: list[TrackedPoses]) -> TrackedPoses:
        """Concatenate the moments of these poses and of others."""
        every = (self, *others)
        return TrackedPoses(
            *(np.concatenate([getattr(s, n) for s in every]) for n in ("place", "pose", "weight"))
        )


@dataclass(frozen=True)
class Fit:
    """Shapes fitted to tracked poses.

    Attributes:
        x: Parameters (B, P) of the shapes: error of the base, then strains at the knots.
        misses: Residuals (B, J, 2) of position and axes in standard deviations; NaN if not
            measured.
        effort: Squared deviation (B,) of strains and base from rest, in the variances of the
            generic prior.
    """

    x: Array
    misses: Array
    effort: Array


class Rod:
    """Generic rod with a robot's length, rest shape, base and largest extension."""

    def __init__(self, robot: Robot, free_base: bool = False) -> None:
        self.length = robot.length
        rest = robot.prior.rest_state(Grid(robot.arclength_nodes, [0.0]))
        middle = (np.arange(_PIECES) + 0.5) * robot.length / _PIECES
        nodes, strain = robot.arclength_nodes, rest.strain[0]
        self.rest = np.stack([np.interp(middle, nodes, column) for column in strain.T], axis=-1)
        self.base = rest.pose[0, 0]
        knots = np.linspace(0.0, robot.length, _KNOTS)
        self.blend = np.stack([np.interp(middle, knots, row) for row in np.eye(_KNOTS)], axis=-1)
        self.information = self._information(knots, largest_extension(robot))
        std = _BASE * np.repeat([robot.length, 1.0], 3)
        if free_base or not robot.prior.fixes_base:
            std = np.repeat([10.0 * robot.length, 10.0], 3)
        self.information[:6, :6] = np.diag(std**-2.0)

    def _information(self, knots: Array, stretches: float) -> Array:
        walk = np.minimum(knots[:, None], knots) / self.length
        out = np.zeros((6 + 6 * _KNOTS, 6 + 6 * _KNOTS))
        bend = 3.0 / self.length
        for k, std in enumerate((0.02, 0.02, stretches, bend, bend, 0.5 * bend)):
            at = 6 + k + 6 * np.arange(_KNOTS)
            out[np.ix_(at, at)] = np.linalg.inv(std**2 * (1.0 + 1.5 * walk))
        return out

    def fit(self, seen: TrackedPoses, rounds: int = ROUNDS) -> Fit:
        """Fit shapes to tracked poses by damped Gauss–Newton steps."""
        x = np.zeros((len(seen.place), len(self.information)))
        damping = np.full(len(x), 1e-2)
        stages = np.linspace(0, rounds, _STAGES, endpoint=False).astype(int)
        scale = np.array([1.0 / (_POSITION * self.length), *[1.0 / _AXIS] * 3])
        for step in range(rounds):
            if step in stages:  # from the base outwards, so that each stage starts near its fit
                edge = 1.01 * self.length * np.sum(stages <= step) / _STAGES
                trust = np.where(seen.place <= edge, 1.0, _AHEAD)
                weight = seen.weight * scale * trust[..., None]
                damping[:] = 1e-2
                current = self._linearized(x, seen, weight)
            _, cost, gradient, hessian = current
            diagonal = np.einsum("bii->bi", hessian)[..., None] * np.eye(x.shape[1])
            moved = (
                x
                - np.linalg.solve(hessian + damping[:, None, None] * diagonal, gradient[..., None])[
                    ..., 0
                ]
            )
            trial = self._linearized(moved, seen, weight)
            better = trial[1] < cost
            x = np.where(better[:, None], moved, x)
            for new, old in zip(trial, current, strict=True):
                old[better] = new[better]
            damping = np.clip(np.where(better, 0.1, 10.0) * damping, 1e-7, 1e6)
        pose = current[0]
        effort = np.einsum("bi,ij,bj->b", x, self.information, x)
        return Fit(x, self.missed(pose, seen), effort)

    def seen_by(self, fit: Fit, seen: TrackedPoses) -> Fit:
        """The same shapes with residuals of other poses at the same moments, maybe repeated."""
        times = len(seen.place) // len(fit.x)
        x = np.tile(fit.x, (times, 1))
        misses = self.missed(self._poses(x, seen.place)[0], seen)
        return Fit(x, misses, np.tile(fit.effort, times))

    def _linearized(
        self, x: Array, seen: TrackedPoses, weight: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Poses at the streams, and costs (B,), gradients (B, P) and Hessians (B, P, P)."""
        pose, slope = self._poses(x, seen.place)
        rotation = pose[..., :3, :3]
        off = pose - seen.pose
        axes = np.swapaxes(off[..., :3, :3], -1, -2)
        miss = np.concatenate([off[..., None, :3, 3], axes], axis=-2)
        by_pose = np.zeros((*pose.shape[:2], 4, 3, 6))
        by_pose[..., 0, :, :3] = rotation
        by_pose[..., 1:, :, 3:] = rotation[..., None, :, :] @ _AXES
        rows = (weight[..., None] * miss).reshape(len(x), -1)
        by_pose = (weight[..., None, None] * by_pose).reshape(*pose.shape[:2], 12, 6)
        jacobian = (by_pose @ slope).reshape(len(x), rows.shape[1], -1)
        turned = np.swapaxes(jacobian, -1, -2)
        pull = x @ self.information
        cost = np.sum(rows**2, axis=-1) + np.sum(x * pull, axis=-1)
        gradient = (turned @ rows[..., None])[..., 0] + pull
        return pose, cost, gradient, turned @ jacobian + self.information

    def _poses(self, x: Array, place: Array) -> tuple[Array, Array]:
        """Poses (B, J, 4, 4) at arclengths (B, J), and Jacobians (B, J, 6, P) by the parameters."""
        step = self.length / _PIECES
        strain = self.rest + np.einsum("nk,bkx->bnx", self.blend, x[:, 6:].reshape(-1, _KNOTS, 6))
        pieces = se3.exp(step * strain)
        edges = np.empty((len(x), _PIECES + 1, 4, 4))
        edges[:, 0] = self.base @ se3.exp(x[:, :6])
        for n in range(_PIECES):
            edges[:, n + 1] = edges[:, n] @ pieces[:, n]
        inside = np.clip((place / step).astype(int), 0, _PIECES - 1)
        row = np.arange(len(x))[:, None]
        ahead = place - inside * step
        pose = edges[row, inside] @ se3.exp(ahead[..., None] * strain[row, inside])
        twists = step * se3.adjoint(edges[:, 1:]).reshape(len(x), _PIECES, 36)  # in the world
        before = (np.arange(_PIECES) < inside[..., None])[..., None, :] * self.blend.T
        turned = before.reshape(len(x), -1, _PIECES) @ twists
        turned = turned.reshape(*place.shape, _KNOTS, 6, 6).swapaxes(2, 3)
        base = np.broadcast_to(se3.adjoint(edges[:, 0])[:, None], (*place.shape, 6, 6))
        slope = np.concatenate([base, turned.reshape(*place.shape, 6, -1)], axis=-1)
        slope = se3.adjoint(se3.inverse(pose)) @ slope
        own = (
            ahead[..., None, None, None]
            * np.eye(6)[:, None]
            * self.blend[inside][..., None, :, None]
        )
        slope[..., 6:] += own.reshape(*place.shape, 6, -1)
        return pose, slope

    def missed(self, pose: Array, seen: TrackedPoses) -> Array:
        """Residuals (B, J, 2) of position and axes in standard deviations; NaN if not measured."""
        off = np.linalg.norm((pose - seen.pose)[..., :3, 3], axis=-1) / (_POSITION * self.length)
        turned = np.linalg.norm((pose - seen.pose)[..., :3, :3], axis=-2) / _AXIS
        known = seen.weight[..., 1:] > 0.0
        turned = np.sqrt(np.sum(np.where(known, turned**2, 0.0), -1) / np.maximum(known.sum(-1), 1))
        return np.stack(
            [
                np.where(seen.weight[..., 0] > 0.0, off, np.nan),
                np.where(known.any(-1), turned, np.nan),
            ],
            axis=-1,
        )


def largest_extension(robot: Robot) -> float:
    """Standard deviation of a robot's extension by its prior, as a strain from 0.02 to 0.5."""
    psd = getattr(robot.prior, "psd_strain_arclength", None)
    if psd is None:
        return 0.1
    base = getattr(robot.prior, "base", None)
    variance = float(np.max(np.asarray(psd)[..., 2])) * robot.length
    variance += 0.0 if base is None else float(base.strain[2])
    return float(np.clip(np.sqrt(variance), 0.02, 0.5))
