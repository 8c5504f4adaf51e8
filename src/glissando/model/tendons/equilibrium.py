"""Shapes of a tendon rod in equilibrium, and their Jacobians by tendons, moments and wrenches.

Source: (M6) and (M7), the manipulator's Jacobians with friction of the tendons.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.tendons.friction import wrench_by_strain
from glissando.model.tendons.tendon_rod import TendonRod

SHAPES = 100
"""Number of shapes computed at a time, since the covariance of each takes a megabyte."""


@dataclass(frozen=True)
class Equilibrium:
    """M shapes of a tendon rod in equilibrium.

    Attributes:
        rod: The rod.
        strain: Strain (M, P, 6) of the pieces.
        tension: Tensions (M, T) at the base, N.
        compliance: ∂strain/∂(wrench on the section) (M, P, 6, 6) at fixed tensions.
        pull: ∂(wrench of the tendons)/∂tension (M, P, 6, T).
        reach: ∂(length of the channel)/∂strain (M, T, P, 6) per length of backbone.
        slope: ∂tension/∂stretch (M, T), N/m; zero where tensions are the inputs.
    """

    rod: TendonRod
    strain: Array
    tension: Array
    compliance: Array
    pull: Array
    reach: Array
    slope: Array

    def pose(self) -> Array:
        """Poses (M, P+1, 4, 4) where pieces meet."""
        steps = se3.exp(self.rod.length[:, None] * self.strain)
        out = [np.broadcast_to(self.rod.base, (len(self.strain), 4, 4))]
        for piece in range(steps.shape[1]):
            out.append(out[-1] @ steps[:, piece])
        return np.stack(out, axis=1)

    def strain_by_tension(self) -> Array:
        """∂strain/∂tension (M, P, 6, T), with tensions as inputs."""
        return self._with_friction(-self.compliance @ self.pull, np.zeros_like(self.slope))

    def strain_by_displacement(self) -> Array:
        """∂strain/∂displacement (M, P, 6, T), with displacements as inputs."""
        by_stretch = self.pull_response * self.slope[:, None]
        return self._with_friction(-self.compliance @ (self.pull @ by_stretch[:, None]), self.slope)

    @cached_property
    def pull_response(self) -> Array:
        """∂tension/∂(tension at a fixed shape) (M, T, T), as rod and tendons yield."""
        m, t = self.slope.shape
        weighted = (self.rod.length[:, None] * self.reach).reshape(m, t, -1)
        give = weighted @ (self.compliance @ self.pull).reshape(m, -1, t)
        return np.asarray(np.linalg.inv(np.eye(t) + self.slope[..., None] * give))

    def wrench_by(self, strain_slope: Array) -> Array:
        """Jacobian (M, P, 6, ·) of the rod's own wrench K (ε − ε*) from that of the strain."""
        return self.rod.stiffness[:, :, None] * strain_slope

    def pose_by(self, strain_slope: Array) -> Array:
        """Jacobian (M, P+1, 6, ·) of the poses, perturbed on the right, from that of the strain.

        δ₊ = Ad(exp(−h ε)) δ + h J_r(h ε) δε over a piece of length h. Source: (M7).
        """
        across, along = self._steps()
        out = [np.zeros((len(self.strain), 6, strain_slope.shape[-1]))]
        for piece in range(across.shape[1]):
            out.append(across[:, piece] @ out[-1] + along[:, piece] @ strain_slope[:, piece])
        return np.stack(out, axis=1)

    def strain_by_moment(self) -> Array:
        """∂strain/∂(bending moment on each piece) (M, P, 6, 2 P), with displacements as inputs.

        A moment bends its own piece, and through the tendons' stretch all pieces that they pass.
        """
        m, count = self.strain.shape[:2]
        own = np.zeros((m, count, 6, 2 * count))
        for piece in range(count):
            own[:, piece, 3:5, 2 * piece : 2 * piece + 2] = np.eye(2)
        return self._with_friction(self.strain_by(own, self.slope), self.slope)

    def strain_by(self, wrench: Array, slope: Array) -> Array:
        """Strains (…, M, P, 6, q) due to wrenches on sections, at constant shares of friction.

        Args:
            wrench: Wrenches (…, M, P, 6, q).
            slope: Derivatives (M, T) of the tendons' tensions by their stretch, N/m.
        """
        free = self.compliance @ wrench
        if not slope.any():
            return free
        weighted = (self.rod.length[:, None] * self.reach).reshape(*slope.shape, -1)
        short = weighted @ free.reshape(*free.shape[:-3], -1, free.shape[-1])
        back = self.pull_response @ (slope[..., None] * short)
        return np.asarray(free - self.compliance @ (self.pull @ back[..., None, :, :]))

    def _with_friction(self, slope: Array, stiffness: Array) -> Array:
        """Jacobians (M, P, 6, ·) of strain, completed by the change of friction with strain.

        With (A + F) S = B and A S₀ = B, S = (1 + A⁻¹ F)⁻¹ S₀; F is the derivative of friction.
        """
        rod, friction = self.rod, self.rod.tendons.friction
        if not friction.any():
            return slope
        m, count = self.strain.shape[:2]
        _, unit, speed, _ = rod.reaches(self.strain)
        force = self.tension[..., None, None] * self.pull.transpose(0, 3, 1, 2)
        channels = friction, rod.length, rod.path[0]
        by_friction = wrench_by_strain(*channels, self.strain, unit, speed, force)
        back = self.strain_by(by_friction.reshape(m, count, 6, -1), stiffness)
        system = np.eye(6 * count) + back.reshape(m, 6 * count, -1)
        corrected = np.linalg.solve(system, slope.reshape(m, 6 * count, -1))
        return np.asarray(corrected.reshape(slope.shape))

    def responses(self) -> tuple[Array, Array]:
        """Jacobians (M, P, 6, ·) of strain by residuals of wrenches and of tensions.

        The first is by each component of the residual wrenches on sections (6 P), the second by the
        residual of each tension (T) from that of its stretch; friction is included.
        """
        m, count = self.strain.shape[:2]
        each = np.eye(6 * count).reshape(count, 6, 6 * count)
        each = np.broadcast_to(each, (m, *each.shape))
        by_tension = -self.compliance @ (self.pull @ self.pull_response[:, None])
        return (
            -self._with_friction(self.strain_by(each, self.slope), self.slope),
            self._with_friction(by_tension, self.slope),
        )

    @cached_property
    def _mean_by_moment(self) -> Array:
        """Jacobian (M, P, 6, 2 P) of the strain by white bending moments of unit density."""
        return self.strain_by_moment() / np.sqrt(np.repeat(self.rod.length, 2))

    def pose_by_moment(self) -> Array:
        """Jacobian (M, P+1, 6, 4 P) of the poses by white bending moments of unit density.

        It is by their means over pieces, and by their first moments about the middles of pieces,
        which displace the ends sideways: the covariance does not depend on the number of pieces.
        """
        mean, length = self._mean_by_moment, self.rod.length
        aside = np.zeros_like(mean)
        by_lever = np.sqrt(length / 12.0)[:, None] / self.rod.stiffness[:, [4, 3]]
        for piece in range(length.size):
            aside[:, piece, :2, 2 * piece : 2 * piece + 2] = np.diag(by_lever[piece])
        return self.pose_by(np.concatenate([mean, aside], axis=-1))

    def cov(self, in_play: Array | float = 0.0) -> Array:
        """Covariance (M, P+1, 12, 12) of poses and strains by the noise in [tendons] and [base].

        Uncertain are the displacements, bending moments along the robot, and the pose of the
        base. The strain of a node is that of the piece before it.

        Args:
            in_play: Further standard deviations (M, T) of the displacements, due to play, m.
        """
        off = np.broadcast_to(np.hypot(self.rod.tendons.std, in_play), self.tension.shape)
        every = (slice(k, k + SHAPES) for k in range(0, len(off), SHAPES))
        return np.concatenate([self._take(rows)._cov(off[rows]) for rows in every])

    def arrays(self) -> list[Array]:
        """Arrays with one row a shape, in the order of the fields."""
        return [getattr(self, field.name) for field in fields(self)[1:]]

    def _take(self, rows: slice) -> Equilibrium:
        """Equilibrium of some of the shapes."""
        return Equilibrium(self.rod.take(rows), *(array[rows] for array in self.arrays()))

    def _cov(self, off: Array) -> Array:
        """Covariance with total standard deviations (M, T) of the displacements."""
        m, count = self.strain.shape[:2]
        root = np.sqrt(self.rod.tendons.psd_moment)
        by_pull = off[:, None, None] * self.strain_by_displacement()
        by_moment = root * self._mean_by_moment
        by_base = [np.broadcast_to(np.diag(np.sqrt(self.rod.var_base)), (m, 6, 6))]
        for across in self._steps()[0].swapaxes(0, 1):
            by_base.append(across @ by_base[-1])
        poses = [self.pose_by(by_pull), root * self.pose_by_moment(), np.stack(by_base, axis=1)]
        nothing = np.zeros((m, count, 6, 2 * count + 6))
        by_strain = np.concatenate([by_pull, by_moment, nothing], axis=-1)
        before = np.maximum(np.arange(count + 1) - 1, 0)
        both = np.concatenate([np.concatenate(poses, axis=-1), by_strain[:, before]], axis=2)
        return np.asarray(both @ np.swapaxes(both, -1, -2))

    def _steps(self) -> tuple[Array, Array]:
        """Ad(exp(−h ε)) and h J_r(h ε), each (M, P, 6, 6)."""
        turned = self.rod.length[:, None] * self.strain
        along = self.rod.length[:, None, None] * se3.right_jacobian(turned)
        return se3.adjoint(se3.exp(-turned)), along
