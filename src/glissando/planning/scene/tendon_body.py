"""A tendon robot's shapes over time, their Jacobians by model errors, and a backward pass.

A model error ξ is whitened by the standard deviations in [tendons] and [base] of a robot file. It
has one component for each tendon, the error of its displacement, two for each piece, bending
moments that the model lacks, and six for the base if its pose is uncertain. Spatial twists by ξ add
up along the body, V(s) = Σ h Ad(T) ∂ε/∂ξ, and a place p moves by V_linear + V_angular × p. The
backward pass propagates gradients by places and twists to the tendons' commands, through the second
derivative of the equilibrium's energy. Source: (M5) to (M7) of docs/tendons.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.grid import Index
from glissando.model.robot import Robot
from glissando.model.tendons.equilibrium import Equilibrium
from glissando.model.tendons.statics import equilibrium
from glissando.model.tendons.tendon_rod import TendonRod, tendon_rod
from glissando.planning.scene.equilibrium_slopes import back_to_displacement

_KNOWN = 0.02  # tip motion by the base over the tendons' radius, below which the base is known
_EASE = 1e-3  # relative singular value of the bends' Jacobian below which none is corrected

BySeen = tuple[Index, Index, Array]
"""Indices (…,) of shapes and of places, and gradients (G, …, 6, q) of G values by twists there."""


@dataclass(frozen=True)
class TendonBody:
    """A rod of P pieces with T tendons, and N places along it.

    Friction and play of the tendons are not modelled; half of the play is included in `std`.

    Attributes:
        rod: The rod, without friction and play.
        steps: Number of steps (P,) in each piece; N = 1 + Σ steps.
        time_scale: Correlation time of the model error, s.
        std: Standard deviations (T,) of actual minus commanded displacements, m.
        base: Square root (6, b) of the base pose's covariance; b = 0 if the base is known.
    """

    rod: TendonRod
    steps: Index
    time_scale: float
    std: Array
    base: Array

    @property
    def errors(self) -> int:
        """Number q = T + 2 P + b of components of a model error."""
        return len(self.rod.tendons) + 2 * len(self.rod.length) + self.base.shape[1]

    @cached_property
    def piece(self) -> Index:
        """Index (N−1,) of the piece of each step."""
        return np.repeat(np.arange(self.steps.size), self.steps)

    @cached_property
    def step(self) -> Array:
        """Lengths (N−1,) of the steps, m."""
        return (self.rod.length / self.steps)[self.piece]

    @cached_property
    def arclength(self) -> Array:
        """Arclengths (N,) of the places, m."""
        return np.concatenate([[0.0], np.cumsum(self.step)])

    @property
    def straight_std(self) -> float:
        """Root of the total variance of the tip's position at zero displacements, m."""
        return float(np.linalg.norm(self.shapes(np.zeros((1, len(self.rod.tendons)))).moves[0, -1]))

    @cached_property
    def left(self) -> Array:
        """Matrix L (q, q), the part of a known model error that tendons cannot correct.

        An error of the base remains in full. Of the bends E by the other errors, displacements with
        bends B leave (I − B B⁺) E, expressed as moments. Evaluated for the straight body, since
        bent shapes differ little.
        """
        count, own = len(self.rod.tendons), self.errors - self.base.shape[1]
        shapes = self.shapes(np.zeros((1, count)))
        bends = shapes.strain_by_error[0, :, 3:5].reshape(-1, self.errors)[:, :own]
        pulled = shapes.strain_by_displacement[0, :, 3:5].reshape(-1, count)
        rest = bends - pulled @ (np.linalg.pinv(pulled, rcond=_EASE) @ bends)
        out = np.diag(np.repeat([0.0, 1.0], [own, self.base.shape[1]]))
        if np.linalg.norm(rest) > _EASE * np.linalg.norm(bends):
            out[count:own, :own] = np.linalg.pinv(bends[:, count:]) @ rest
        return out

    @property
    def moment_std(self) -> Array:
        """Standard deviations (2 P,) of the unmodelled bending moments, N m."""
        return np.sqrt(self.rod.tendons.psd_moment / np.repeat(self.rod.length, 2))

    def shapes(
        self, displacement: Array, error: Array | None = None, start: Array | None = None
    ) -> BodyShapes:
        """Equilibrium shapes for given tendon displacements.

        Args:
            displacement: Displacements (K, T) of the tendons, m.
            error: Expected model errors (K, q); None for zero.
            start: Initial strains (K, P, 6) of the iteration, for instance of a similar motion.

        Raises:
            NoShapeError: No static equilibrium was found.
        """
        rod, base = self.rod, np.broadcast_to(self.rod.base, (len(displacement), 4, 4))
        if error is not None:
            parts = np.cumsum([len(rod.tendons), self.moment_std.size])
            by_pull, by_moment, by_base = np.split(error, parts, axis=-1)
            displacement = displacement + self.std * by_pull
            rest = np.broadcast_to(rod.rest, (len(displacement), *rod.rest.shape)).copy()
            moment = np.broadcast_to(self.moment_std * by_moment, (len(rest), rest[0, :, :2].size))
            rest[..., 3:5] += moment.reshape(rest[..., 3:5].shape) / rod.stiffness[:, 3:5]
            rod, start = replace(rod, rest=rest), rest if start is None else start
            base = base @ se3.exp(by_base @ self.base.T)
        return BodyShapes(self, equilibrium(rod, displacement=displacement, start=start), base)


def tendon_body(robot: Robot, spacing: float) -> TendonBody:
    """Create the body of a robot with [tendons] and a mechanical prior.

    With straight tendons the bending is uniform in a segment, so a piece is a segment; helical
    tendons need pieces between the arclength nodes.

    Args:
        robot: The robot.
        spacing: Largest distance between two places, m.

    Raises:
        GlissandoError: The robot has no tendons, or its prior is not mechanical.
    """
    tendons = robot.tendons
    rod = tendon_rod(robot, np.zeros(0) if tendons is not None and tendons.straight else None)
    count = len(rod.tendons)
    std = np.hypot(rod.tendons.std, 0.5 * rod.tendons.play)
    rod = replace(rod, tendons=replace(rod.tendons, friction=np.zeros(count), play=np.zeros(count)))
    steps = np.maximum(2, np.ceil(rod.length / spacing)).astype(np.intp)
    time_scale, base = float(getattr(robot.prior, "time_scale", np.inf)), np.sqrt(rod.var_base)
    body = TendonBody(rod, steps, time_scale, std, np.zeros((6, 0)))
    moved = float(np.linalg.norm(base * np.repeat([1.0, robot.length], 3)))
    known = moved < _KNOWN * float(np.min(rod.tendons.radius))
    return body if known else replace(body, base=np.diag(base))


@dataclass(frozen=True)
class BodyShapes:
    """K shapes of a body in the world frame.

    Attributes:
        body: The body.
        balance: The K equilibria.
        base: Poses (K, 4, 4) of the base.
    """

    body: TendonBody
    balance: Equilibrium
    base: Array

    @cached_property
    def _fine(self) -> Array:
        """Poses (K, 2N−1, 4, 4) at the places and at the midpoints between them."""
        body, piece = self.body, np.repeat(self.body.piece, 2)
        half = (0.5 * body.rod.length / body.steps)[:, None] * self.balance.strain
        step = se3.exp(half)
        out = np.empty((len(half), piece.size + 1, 4, 4))
        out[:, 0] = self.base
        for n, p in enumerate(piece):
            np.matmul(out[:, n], step[:, p], out=out[:, n + 1])
        return out

    @property
    def pose(self) -> Array:
        """Poses (K, N, 4, 4) at the places."""
        return self._fine[:, ::2]

    def pose_at(self, arclength: Array) -> Array:
        """Poses (K, M, 4, 4) at arclengths (M,)."""
        body = self.body
        step = np.clip(np.searchsorted(body.arclength, arclength) - 1, 0, body.step.size - 1)
        beyond = (arclength - body.arclength[step])[:, None] * self.balance.strain[
            :, body.piece[step]
        ]
        return self.pose[:, step] @ se3.exp(beyond)

    @property
    def place(self) -> Array:
        """Positions (K, N, 3) of the places, m."""
        return self.pose[..., :3, 3]

    @cached_property
    def strain_by_displacement(self) -> Array:
        """∂strain/∂displacement (K, P, 6, T)."""
        return self.balance.strain_by_displacement()

    @cached_property
    def strain_by_error(self) -> Array:
        """∂strain/∂ξ (K, P, 6, q)."""
        balance, body = self.balance, self.body
        by_pull = body.std * self.strain_by_displacement
        by_moment = body.moment_std * balance.strain_by_moment()
        by_base = np.zeros((*by_pull.shape[:-1], body.base.shape[1]))
        return np.concatenate([by_pull, by_moment, by_base], axis=-1)

    @cached_property
    def twist(self) -> Array:
        """Spatial twists (K, N, 6, q) of the places by ξ, by the midpoint rule over each step."""
        middle, by_error = self._fine[:, 1::2], self.strain_by_error[:, self.body.piece]
        out = _cumulative_sum(self.body.step[:, None, None] * (se3.adjoint(middle) @ by_error))
        own = out.shape[-1] - self.body.base.shape[1]
        out[..., own:] = (se3.adjoint(self.base) @ self.body.base)[:, None]
        return out

    @cached_property
    def moves(self) -> Array:
        """∂place/∂ξ (K, N, 3, q), m."""
        place = self.place[..., None]
        return self.twist[..., :3, :] + _cross(self.twist[..., 3:, :], place)

    def body_twist_at(self, shape: Index, place: Index) -> Array:
        """Twists (…, 6, q) by ξ in the body frame, at indices (…,) of shapes and of places."""
        back = self.pose[shape, place, :3, :3].mT
        angular = self.twist[shape, place, 3:]
        return np.concatenate([back @ self.moves[shape, place], back @ angular], axis=-2)

    def tip_by_displacement(self) -> Array:
        """∂(position of the tip)/∂displacement (K, 3, T), world frame."""
        slope = self.balance.pose_by(self.strain_by_displacement)[:, -1, :3]
        return self.pose[:, -1, :3, :3] @ slope

    def back(self, by_place: Array, by_moves: Array, by_seen: Sequence[BySeen]) -> Array:
        """Gradients (G, K, T) by displacements, of G values whose partial gradients are given.

        Args:
            by_place: Gradient (G, K, N, 3) by `place`.
            by_moves: Gradient (G, K, N, 3, q) by `moves`.
            by_seen: Gradients by results of `body_twist_at`, with their indices.
        """
        by_moves, by_turn, twist = by_moves.copy(), np.zeros_like(by_place), self.twist
        by_angular = np.zeros_like(by_moves)
        for *at, slope in by_seen:
            here = tuple(at)
            turn, own = self.pose[here][..., :3, :3], twist[here][..., 3:, :]
            linear, angular = turn @ slope[..., :3, :], turn @ slope[..., 3:, :]
            turned = -_summed_cross(self.moves[here], linear) - _summed_cross(own, angular)
            for whole, part in ((by_turn, turned), (by_moves, linear), (by_angular, angular)):
                for one, its_part in zip(whole, part, strict=True):
                    np.add.at(one, here, its_part)
        by_place = by_place + _summed_cross(by_moves, twist[..., 3:, :])
        by_angular += _cross(self.place[..., None], by_moves)
        by_twist = np.concatenate([by_moves, by_angular], axis=-2)
        by_step = _cumulative_sum(by_twist[..., :0:-1, :, :])[..., :0:-1, :, :]
        by_step *= self.body.step[:, None, None]
        by_strain_slope, wrench_middle = self._back_steps(by_step)
        wrench = np.zeros((len(by_place), *self._fine.shape[:2], 6))
        wrench[..., ::2, :3] = by_place
        wrench[..., ::2, 3:] = np.cross(self.place, by_place) + by_turn
        wrench[..., 1::2, :] = wrench_middle
        by_strain = self._by_strain(wrench)
        moved = self.strain_by_displacement, self.strain_by_error, self.body.std
        return back_to_displacement(self.balance, moved, by_strain, by_strain_slope)

    def _back_steps(self, by_step: Array) -> tuple[Array, Array]:
        """Gradients by `strain_by_error`, from those (G, K, N−1, 6, q) by the twists of steps.

        Also returns gradients (G, K, N−1, 6) by spatial twists of the midpoints, as wrenches.
        """
        middle = self._fine[:, 1::2]
        turn, place = middle[..., :3, :3], middle[..., :3, 3, None]
        moved = by_step[..., 3:, :] + _cross(by_step[..., :3, :], place)
        slope = np.concatenate([by_step[..., :3, :], moved], axis=-2)
        rows = turn.mT[:, :, None] @ slope.reshape(*slope.shape[:-2], 2, 3, -1)
        rows = self._by_piece(rows.reshape(slope.shape), axis=2)
        own = self.strain_by_error[:, self.body.piece]
        linear, angular = turn @ own[..., :3, :], turn @ own[..., 3:, :]
        by_place = _summed_cross(angular, by_step[..., :3, :])
        by_turn = _summed_cross(linear, by_step[..., :3, :]) + _summed_cross(angular, moved)
        wrench = np.concatenate([by_place, np.cross(place[..., 0], by_place) + by_turn], axis=-1)
        return rows, wrench

    def _by_piece(self, by_step: Array, axis: int) -> Array:
        """Sums (…, P, …) of rows (…, N−1, …) over the steps of each piece."""
        first = np.concatenate([[0], np.cumsum(self.body.steps)[:-1]])
        return np.add.reduceat(by_step, first, axis=axis)

    def _by_strain(self, wrench: Array) -> Array:
        """Gradients (G, K, P, 6) by strain, from wrenches (G, K, 2N−1, 6) on the poses."""
        ahead = _cumulative_sum(wrench[..., :0:-1, :, None])[..., :0:-1, :, :]
        local = (se3.adjoint(self._fine[:, :-1]).mT @ ahead)[..., 0]
        local = self._by_piece(local[..., ::2, :] + local[..., 1::2, :], axis=2)
        half = (0.5 * self.body.rod.length / self.body.steps)[:, None]
        along = half[..., None] * se3.left_jacobian(half * self.balance.strain)
        return np.asarray((along.mT @ local[..., None])[..., 0])


def _cumulative_sum(steps: Array) -> Array:
    """Cumulative sums (…, N+1, 6, q), beginning with zero, of steps (…, N, 6, q)."""
    *lead, count, rows, columns = steps.shape
    out = np.zeros((*lead, count + 1, rows, columns))
    for n in range(count):  # several times as fast as cumsum along an axis in the middle
        np.add(out[..., n, :, :], steps[..., n, :, :], out=out[..., n + 1, :, :])
    return out


def _cross(a: Array, b: Array) -> Array:
    """Cross products of columns (…, 3, q)."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -2, 0), np.moveaxis(b, -2, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-2)


def _summed_cross(a: Array, b: Array) -> Array:
    """Sums (…, 3) over the q columns of the cross products of columns (…, 3, q)."""
    product = a @ b.mT
    return np.stack(
        [
            product[..., 1, 2] - product[..., 2, 1],
            product[..., 2, 0] - product[..., 0, 2],
            product[..., 0, 1] - product[..., 1, 0],
        ],
        axis=-1,
    )
