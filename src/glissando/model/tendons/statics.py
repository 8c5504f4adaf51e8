"""The shape that tendons pull an unloaded rod into, and how it depends on each of them.

Without loads from outside, the rod's own wrench balances its tendons at every cross-section,

    K (ε − ε*) + Σ τ_j [t_j; r_j × t_j] = 0,    t_j = (ν + u × r_j + r_j′) / |…|,

and a tendon's tension follows from its stretch d_j − slack_j − (ℓ_j(straight) − ℓ_j). Strains at
different places are tied by the tensions alone: a Newton step solves 6 numbers a piece and T
numbers a shape. Source: (M5) to (M7); Rucker and Webster 2011 without external loads.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from glissando.errors import GlissandoError, NoShapeError
from glissando.geometry import se3
from glissando.geometry.se3 import Array
from glissando.model.priors.rest_shape import STRAIGHT
from glissando.model.tendons.friction import share_left, wrench_by_strain
from glissando.model.tendons.tendon_rod import TendonRod

_ITERATIONS = 60
_CLOSE = 1e-9  # of a step of all pieces together, rad and relative stretch
_LONGEST = 0.5  # rad that a step may turn a piece by
_SHAPES = 100  # that are computed at a time, as the covariance of each takes a megabyte


@dataclass(frozen=True)
class Equilibrium:
    """M shapes of a tendon rod in equilibrium.

    Attributes:
        rod: The rod.
        strain: Strain (M, P, 6) of the pieces.
        tension: Tensions (M, T) at the base, N.
        compliance: ∂strain/∂(wrench on the section) (M, P, 6, 6) at fixed tensions.
        pull: ∂(wrench of the tendons)/∂tension (M, P, 6, T).
        reach: ∂(length of the channel)/∂strain (M, T, P, 6) for a length of backbone.
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
        """∂strain/∂tension (M, P, 6, T), tensions being the inputs."""
        return self._rubbing(-self.compliance @ self.pull, np.zeros_like(self.slope))

    def strain_by_displacement(self) -> Array:
        """∂strain/∂displacement (M, P, 6, T), displacements being the inputs."""
        by_stretch = self.pull_response * self.slope[:, None]
        return self._rubbing(-self.compliance @ (self.pull @ by_stretch[:, None]), self.slope)

    @cached_property
    def pull_response(self) -> Array:
        """∂tension/∂(what a tendon would pull with) (M, T, T), as the rod and tendons yield."""
        m, t = self.slope.shape
        weighted = (self.rod.length[:, None] * self.reach).reshape(m, t, -1)
        give = weighted @ (self.compliance @ self.pull).reshape(m, -1, t)
        return np.asarray(np.linalg.inv(np.eye(t) + self.slope[..., None] * give))

    def wrench_by(self, strain_slope: Array) -> Array:
        """Slope (M, P, 6, ·) of the rod's own wrench K (ε − ε*) from that of the strain."""
        return self.rod.stiffness[:, :, None] * strain_slope

    def pose_by(self, strain_slope: Array) -> Array:
        """Slope (M, P+1, 6, ·) of the poses, perturbed on the right, from that of the strain.

        δ₊ = Ad(exp(−h ε)) δ + h J_r(h ε) δε over a piece of length h. Source: (M7).
        """
        across, along = self._steps()
        out = [np.zeros((len(self.strain), 6, strain_slope.shape[-1]))]
        for piece in range(across.shape[1]):
            out.append(across[:, piece] @ out[-1] + along[:, piece] @ strain_slope[:, piece])
        return np.stack(out, axis=1)

    def strain_by_moment(self) -> Array:
        """∂strain/∂(bending moment on each piece) (M, P, 6, 2 P), displacements being the inputs.

        A moment bends its own piece, and through the tendons' stretch all that they pass.
        """
        m, count = self.strain.shape[:2]
        own = np.zeros((m, count, 6, 2 * count))
        for piece in range(count):
            own[:, piece, 3:5, 2 * piece : 2 * piece + 2] = np.eye(2)
        return self._rubbing(self.strain_by(own, self.slope), self.slope)

    def strain_by(self, wrench: Array, slope: Array) -> Array:
        """Strains (…, M, P, 6, q) by wrenches on sections, at what friction leaves of tensions.

        Args:
            wrench: Wrenches (…, M, P, 6, q).
            slope: Slopes (M, T) of the tendons' tensions by their stretch.
        """
        free = self.compliance @ wrench
        if not slope.any():
            return free
        weighted = (self.rod.length[:, None] * self.reach).reshape(*slope.shape, -1)
        short = weighted @ free.reshape(*free.shape[:-3], -1, free.shape[-1])
        back = self.pull_response @ (slope[..., None] * short)
        return np.asarray(free - self.compliance @ (self.pull @ back[..., None, :, :]))

    def _rubbing(self, slope: Array, stiffness: Array) -> Array:
        """Slopes (M, P, 6, ·) of strain with those of what friction leaves of the tensions.

        With (A + F) S = B and A S₀ = B, S = (1 + A⁻¹ F)⁻¹ S₀; F is how friction goes with strain.
        """
        rod, friction = self.rod, self.rod.tendons.friction
        if not friction.any():
            return slope
        m, count = self.strain.shape[:2]
        _, unit, speed, _ = reaches(rod, self.strain)
        force = self.tension[..., None, None] * self.pull.transpose(0, 3, 1, 2)
        channels = friction, rod.length, rod.path[0]
        eased = wrench_by_strain(*channels, self.strain, unit, speed, force)
        back = self.strain_by(eased.reshape(m, count, 6, -1), stiffness)
        whole = np.eye(6 * count) + back.reshape(m, 6 * count, -1)
        rubbed = np.linalg.solve(whole, slope.reshape(m, 6 * count, -1))
        return np.asarray(rubbed.reshape(slope.shape))

    def responses(self) -> tuple[Array, Array]:
        """Slopes (M, P, 6, ·) of strain by what wrenches and tensions are off by.

        The misfit of the balance in each number of the sections' wrenches (6 P), and that of each
        tension (T) by its stretch, friction and all.
        """
        m, count = self.strain.shape[:2]
        each = np.eye(6 * count).reshape(count, 6, 6 * count)
        each = np.broadcast_to(each, (m, *each.shape))
        by_tension = -self.compliance @ (self.pull @ self.pull_response[:, None])
        return (
            -self._rubbing(self.strain_by(each, self.slope), self.slope),
            self._rubbing(by_tension, self.slope),
        )

    @cached_property
    def _mean_by_moment(self) -> Array:
        """Slopes (M, P, 6, 2 P) of the strain by white bending moments of unit density."""
        return self.strain_by_moment() / np.sqrt(np.repeat(self.rod.length, 2))

    def pose_by_moment(self) -> Array:
        """Slopes (M, P+1, 6, 4 P) of the poses by white bending moments of unit density.

        By their means over the pieces, and by their first moments about the middles of these, which
        move a piece's end aside: the covariance does not depend on the pieces.
        """
        mean, length = self._mean_by_moment, self.rod.length
        aside = np.zeros_like(mean)
        by_lever = np.sqrt(length / 12.0)[:, None] / self.rod.stiffness[:, [4, 3]]
        for piece in range(length.size):
            aside[:, piece, :2, 2 * piece : 2 * piece + 2] = np.diag(by_lever[piece])
        return self.pose_by(np.concatenate([mean, aside], axis=-1))

    def cov(self, in_play: Array | float = 0.0) -> Array:
        """Covariance (M, P+1, 12, 12) of poses and strains that [tendons] and [base] state.

        Displacements differ from the commands, moments are missing along the robot, and the base
        stands about its pose. The strain of a node is that of the piece before it.

        Args:
            in_play: Standard deviations (M, T) by which displacements are off besides, m.
        """
        off = np.broadcast_to(np.hypot(self.rod.tendons.std, in_play), self.tension.shape)
        every = (slice(k, k + _SHAPES) for k in range(0, len(off), _SHAPES))
        return np.concatenate([self._take(rows)._cov(off[rows]) for rows in every])

    def arrays(self) -> list[Array]:
        """What there is of each shape, in the order of the fields."""
        return [getattr(self, field.name) for field in fields(self)[1:]]

    def _take(self, rows: slice) -> Equilibrium:
        """Some of the shapes."""
        return Equilibrium(self.rod.take(rows), *(array[rows] for array in self.arrays()))

    def _cov(self, off: Array) -> Array:
        """That covariance, where displacements are off by standard deviations (M, T) in all."""
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


def equilibrium(
    rod: TendonRod,
    *,
    displacement: Array | None = None,
    tension: Array | None = None,
    start: Array | None = None,
) -> Equilibrium:
    """The shapes that displacements or tensions of the tendons pull the rod into.

    Args:
        rod: The rod.
        displacement: Displacements (M, T), positive when pulled, less play, m.
        tension: Tensions (M, T) in the place of displacements, N.
        start: Strains (M, P, 6) to begin at.

    Raises:
        GlissandoError: Neither or both are given, a number is missing, or a tension is negative.
        NoShapeError: No equilibrium was found.
    """
    given, found = _checked_inputs(rod, displacement, tension), []
    if start is None:
        start = np.broadcast_to(rod.rest, (len(given), *rod.rest.shape[-2:]))
    for first in range(0, len(given), _SHAPES):
        rows = slice(first, first + _SHAPES)
        part = rod.take(rows), given[rows], start[rows], first
        found.append(_solved(*part, tensions=displacement is None))
    joined = zip(*(each.arrays() for each in found), strict=True)
    return Equilibrium(rod, *(np.concatenate(parts) for parts in joined))


def _solved(
    rod: TendonRod, given: Array, strain: Array, first: int, *, tensions: bool
) -> Equilibrium:
    """The shapes of rows from the `first` on, by Newton's method from strains (M, P, 6)."""
    for _ in range(_ITERATIONS):
        here, residual = _linearize(rod, strain, given, tensions)
        step = here.strain_by(residual[..., None], here.slope)[..., 0]  # Newton's, to be taken off
        turned = np.abs(step * rod.length[:, None]).max(axis=(1, 2), keepdims=True)
        strain = strain - step * np.minimum(1.0, _LONGEST / np.maximum(turned, 1e-300))
        if turned.max() < _CLOSE:
            return replace(here, strain=strain)
    worst = first + int(np.argmax(turned.ravel()))
    raise NoShapeError(
        f"No static shape was found for row {worst} of the tendons; is the rod buckling, or is a "
        f"displacement in millimetres?"
    )


def _checked_inputs(rod: TendonRod, displacement: Array | None, tension: Array | None) -> Array:
    if (displacement is None) == (tension is None):
        raise GlissandoError("Give displacements of the tendons or their tensions, one of the two.")
    given = np.atleast_2d(np.asarray(displacement if tension is None else tension, dtype=float))
    if given.shape[1] != len(rod.tendons) or not np.all(np.isfinite(given)):
        raise GlissandoError(
            f"{given.shape[1]} columns for {len(rod.tendons)} tendons; give a finite number each."
        )
    if tension is not None and np.any(given < 0.0):
        raise GlissandoError(f"A tension of {given.min():g} N cannot be; tendons only pull.")
    if displacement is not None and np.any(np.abs(given) > rod.nodes[-1]):
        raise GlissandoError(
            f"A tendon is displaced by {np.abs(given).max():g} m, more than the robot's length of "
            f"{rod.nodes[-1]:g} m; give metres, not millimetres."
        )
    return given


def _linearize(
    rod: TendonRod, strain: Array, given: Array, tensions: bool
) -> tuple[Equilibrium, Array]:
    """The balance linearised at strains (M, P, 6), and the wrenches (M, P, 6) left over."""
    reach, unit, speed, inside = reaches(rod, strain)
    stretch = given - shortening(rod, strain) - rod.tendons.slack
    force, slope = (given, np.zeros_like(given)) if tensions else rod.tendons.tension(stretch)
    left = share_left(rod.tendons.friction, rod.length, strain, unit) * inside
    pull = (reach * left[..., None]).transpose(0, 2, 3, 1)
    residual = _balance(rod, strain, pull, force)
    compliance = np.asarray(np.linalg.inv(_hessian(rod, unit, (force[..., None] * left) / speed)))
    free = reach * inside[..., None]
    return Equilibrium(rod, strain, force, compliance, pull, free, slope), residual


def _balance(rod: TendonRod, strain: Array, pull: Array, tension: Array) -> Array:
    """Wrench (M, P, 6) of the rod and of its tendons on each section, zero in equilibrium."""
    return rod.stiffness * (strain - rod.rest) + (pull @ tension[:, None, :, None])[..., 0]


def misfit(
    rod: TendonRod, strain: Array, tension: Array, displacement: Array
) -> tuple[Array, Array]:
    """How far a rod is from balance at strains and tensions that need not be its own.

    Args:
        rod: The rod.
        strain: Strains (M, P, 6).
        tension: Tensions (M, T), N.
        displacement: Displacements (M, T), less play, m.

    Returns:
        Wrenches left (M, P, 6), and the tensions (M, T) of the tendons' stretch.
    """
    reach, unit, _, inside = reaches(rod, strain)
    left = share_left(rod.tendons.friction, rod.length, strain, unit) * inside
    pull = (reach * left[..., None]).transpose(0, 2, 3, 1)
    stretch = displacement - shortening(rod, strain) - rod.tendons.slack
    return _balance(rod, strain, pull, tension), rod.tendons.tension(stretch)[0]


def levers(rod: TendonRod) -> Array:
    """∂tangent/∂strain (T, P, 3, 6) of the channels."""
    place = rod.path[0]
    return np.concatenate([np.broadcast_to(np.eye(3), (*place.shape, 3)), -se3.hat3(place)], -1)


def reaches(rod: TendonRod, strain: Array) -> tuple[Array, Array, Array, Array]:
    """∂|tangent|/∂strain (M, T, P, 6), unit tangents, their lengths, and where tendons are."""
    place, slope = rod.path
    tangent = strain[:, None, :, :3] + np.cross(strain[:, None, :, 3:], place) + slope
    speed = np.linalg.norm(tangent, axis=-1)
    unit = tangent / speed[..., None]
    arm = np.cross(np.broadcast_to(place, unit.shape), unit)
    inside = (rod.middle < rod.tendons.end[:, None]).astype(float)
    return np.concatenate([unit, arm], axis=-1), unit, speed, inside


def shortening(rod: TendonRod, strain: Array) -> Array:
    """How much shorter (M, T) channels are at strains (M, P, 6) than in the straight rod, m."""
    place, slope = rod.path
    inside = rod.length * (rod.middle < rod.tendons.end[:, None])
    straight = np.linalg.norm(STRAIGHT[:3] + slope, axis=-1)
    tangent = strain[:, None, :, :3] + np.cross(strain[:, None, :, 3:], place) + slope
    return np.sum(inside * (straight - np.linalg.norm(tangent, axis=-1)), axis=-1)


def _hessian(rod: TendonRod, unit: Array, force: Array) -> Array:
    """Stiffness (M, P, 6, 6) of the sections under the tendons' `force` (M, T, P) over length."""
    out = np.zeros((unit.shape[0], unit.shape[2], 6, 6))
    out += rod.stiffness[:, :, None] * np.eye(6)
    for j, arm in enumerate(levers(rod)):
        t = unit[:, j]
        across = force[:, j, :, None, None] * (np.eye(3) - t[..., :, None] * t[..., None, :])
        out += np.swapaxes(arm, -1, -2) @ across @ arm
    return out
